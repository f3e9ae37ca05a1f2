"""What all types of tensors share: they move, are indexed, saved and shown alike, by what their fields declare."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, ClassVar, TypeVar

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.types.collation import collated_by
from torchreg.types.held import Change, held_by
from torchreg.types.indexing import numbers_of
from torchreg.types.loading import loadable
from torchreg.types.pytrees import register_pytree
from torchreg.types.shown import html_of, kinds_of, text_of

AnyRecord = TypeVar("AnyRecord", bound="Record")
AnyBatch = TypeVar("AnyBatch", bound="PackedBatch")


class Record:
    """A frozen dataclass of tensors: it moves to devices, loads by ``torch.load`` as it is, and is a pytree.

    Fields say by ``torchreg.types.held`` what they hold.
    """

    def __init_subclass__(cls, **more: Any) -> None:  # noqa: ANN401
        super().__init_subclass__(**more)
        register_pytree(loadable(cls))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Check what was read from a file or came from another process, as when made."""
        type(self).__init__(self, **state)

    def moved(self: AnyRecord, change: Change) -> AnyRecord:
        """The record with every tensor but offsets changed by a function, which gets to know whether its dtype may.

        Numbers are not read: a copy that is not waited for may not be there yet.
        """
        made = object.__new__(type(self))
        for name, held in held_by(type(self)).items():
            object.__setattr__(made, name, held.moved(getattr(self, name), change))
        return made

    def to(
        self: AnyRecord,
        device: torch.device | str | int | torch.dtype | Tensor | None = None,
        dtype: torch.dtype | None = None,
        *,
        non_blocking: bool = False,
    ) -> AnyRecord:
        """Copy to a device, or change the dtype of what has that of the points, as ``Tensor.to``.

        What is declared float64 or a whole number, such as origins, transforms and rows, keeps its dtype, and offsets
        stay on the CPU.

        Args:
            device: where to, or a dtype, or a tensor whose device and dtype are meant.
            dtype: of floating point.
            non_blocking: do not wait for copies from page-locked memory (``pin_memory``) to a GPU.
        """
        if isinstance(device, Tensor):
            dtype, device = device.dtype, device.device
        elif isinstance(device, torch.dtype):
            device, dtype = None, device
        expect(dtype is None or dtype.is_floating_point, "dtype", "one of floating point", dtype)

        def change(value: Tensor, casts: bool) -> Tensor:
            return value.to(device=device, dtype=dtype if casts else None, non_blocking=non_blocking)

        return self.moved(change)

    def cpu(self: AnyRecord) -> AnyRecord:
        """Copy to the CPU."""
        return self.to("cpu")

    def cuda(self: AnyRecord, device: torch.device | str | int = "cuda", *, non_blocking: bool = False) -> AnyRecord:
        """Copy to a GPU, as ``Tensor.cuda``; a number means that GPU."""
        return self.to(torch.device("cuda", device) if isinstance(device, int) else device, non_blocking=non_blocking)

    def detach(self: AnyRecord) -> AnyRecord:
        """The same tensors, without gradients."""
        return self.moved(lambda value, _: value.detach())

    def pin_memory(self: AnyRecord) -> AnyRecord:
        """Copy into page-locked memory, for faster transfer to a GPU that need not be waited for.

        A ``DataLoader`` with ``pin_memory=True`` calls this where there is a GPU.
        """
        return self.moved(lambda value, _: value.pin_memory())

    def _facts(self) -> Sequence[str]:
        """What ``repr`` says, line by line, three at most."""
        return ("; ".join(kinds_of(self)),)

    def __repr__(self) -> str:
        return text_of(self, self._facts)

    def _repr_html_(self) -> str:
        return html_of(self, self._facts)


class PackedBatch(Record):
    """A record of ``B`` items: it has a length, takes an index, and can be iterated and joined.

    ``batch[1]``, ``batch[-1]``, ``batch[2:5]``, ``batch[[4, 0, 0]]`` and ``batch[batch.success]`` are batches of the
    same type, of one item for a number; tensors are views where the items follow each other.
    """

    noun: ClassVar[str] = "pairs"
    """What the items are, in the plural."""

    def __init_subclass__(cls, **more: Any) -> None:  # noqa: ANN401
        super().__init_subclass__(**more)
        collated_by(f"{cls.__name__}.pack")(cls)

    @classmethod
    def pack(cls: type[AnyBatch], batches: Iterable[AnyBatch]) -> AnyBatch:
        """Join batches into one, in memory of its own; usable as the ``collate_fn`` of a ``DataLoader``.

        A field such as colors must be there for all or for none.

        Raises:
            ValueError: nothing to pack, or a field that some have and others have not.
        """
        listed = list(batches)
        expect(len(listed) > 0, cls.noun, "at least one batch", listed)
        return cls(
            **{
                name: held.joined([getattr(one, name) for one in listed], name, listed)
                for name, held in held_by(cls).items()
            }
        )

    def __getitem__(self: AnyBatch, which: Any) -> AnyBatch:  # noqa: ANN401
        return self._picked(numbers_of(which, len(self), self.noun))

    def __iter__(self: AnyBatch) -> Iterator[AnyBatch]:
        return (self[number] for number in range(len(self)))

    def __len__(self) -> int:
        """The number of items, B."""
        raise NotImplementedError

    def _picked(self: AnyBatch, numbers: Sequence[int]) -> AnyBatch:
        """The batch of these items."""
        return type(self)(
            **{name: held.picked(getattr(self, name), self, numbers) for name, held in held_by(type(self)).items()}
        )

    def _check_counts(self, count: int) -> None:
        """Raise ``ValueError`` where a field does not have as many entries as there are items."""
        for name, held in held_by(type(self)).items():
            held.check(getattr(self, name), name, count)
