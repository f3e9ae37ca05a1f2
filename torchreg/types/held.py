"""What a field holds, declared beside it once: how it is picked, joined, moved, checked and shown follows from that.

A batch of ``B`` items is *packed*: fields hold one row per point (or match), one entry per item, or something that all
items share.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields
from itertools import pairwise
from typing import Any, Literal

import torch
from torch import Tensor

from torchreg.errors import describe, expect, expect_in_words, expect_shape
from torchreg.types.packing import offsets_of, spans

Change = Callable[[Tensor, bool], Tensor]
"""Changes a tensor, given whether its dtype follows that of ``to``."""

_MARK = "held"


@dataclass(frozen=True, kw_only=True)
class Held:
    """What all items of a batch share, such as the times of a run; for fields of one entry or row each see below.

    Attributes:
        casts: whether the dtype of its tensors follows that of ``to``; others keep what they are declared with.
    """

    casts: bool = False

    def picked(self, value: Any, batch: Any, numbers: Sequence[int]) -> Any:  # noqa: ANN401
        """The value of a batch of these items."""
        return value

    def joined(self, values: Sequence[Any], name: str, batches: Sequence[Any]) -> Any:  # noqa: ANN401
        """The value of all batches, at least one, joined."""
        other = next((value for value in values if value != values[0]), values[0])
        expect(other == values[0], name, f"the same in all that are joined, such as {describe(values[0])}", other)
        return values[0]

    def moved(self, value: Any, change: Change) -> Any:  # noqa: ANN401
        """The value with all its tensors changed."""
        if isinstance(value, Tensor):
            return change(value, self.casts)
        if hasattr(value, "moved"):
            return value.moved(change)
        if isinstance(value, tuple):
            return _like(value, (self.moved(item, change) for item in value))
        return value

    def check(self, value: Any, name: str, count: int) -> None:  # noqa: ANN401
        """Raise ``ValueError`` where the value does not fit a batch of ``count`` items."""


class Timings(tuple[tuple[str, float], ...]):
    """Seconds by stage as part of a pytree's structure, where any are as good as others."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, tuple)

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, kw_only=True)
class Times(Held):
    """The seconds of every stage of a run, (name, seconds) in order, which add up where runs are joined."""

    def joined(self, values: Sequence[Any], name: str, batches: Sequence[Any]) -> Any:  # noqa: ANN401
        """The sums by stage; parts of one run have its times, which count once."""
        total: dict[str, float] = {}
        for stage, seconds in (each for value in dict.fromkeys(values) for each in value):
            total[stage] = total.get(stage, 0.0) + seconds
        return tuple(total.items())


@dataclass(frozen=True, kw_only=True)
class PerRow(Held):
    """A tensor of one row per point or match; item ``b`` has those that the offsets name.

    Attributes:
        of: the field with the offsets, or with the batch whose offsets they are.
    """

    of: str = "offsets"

    def picked(self, value: Any, batch: Any, numbers: Sequence[int]) -> Any:  # noqa: ANN401
        """The rows of these items; a view where they lie one after another."""
        if value is None:
            return None
        return picked_rows(value, bounds_of(offsets_in(batch, self.of), numbers))

    def joined(self, values: Sequence[Any], name: str, batches: Sequence[Any]) -> Any:  # noqa: ANN401
        """All rows; a field is there in all batches or in none."""
        return torch.cat(list(values)) if _are_there(values, name, batches) else None


@dataclass(frozen=True, kw_only=True)
class Offsets(Held):
    """Where the rows of each item begin and end, on the CPU wherever the rows are."""

    def picked(self, value: Any, batch: Any, numbers: Sequence[int]) -> Any:  # noqa: ANN401
        """The offsets of these items."""
        return offsets_of(end - begin for begin, end in bounds_of(value, numbers))

    def joined(self, values: Sequence[Any], name: str, batches: Sequence[Any]) -> Any:  # noqa: ANN401
        """The offsets of the items of all batches."""
        return offsets_of(end - begin for value in values for begin, end in spans(value))

    def moved(self, value: Any, change: Change) -> Any:  # noqa: ANN401
        """The same: offsets stay where they are."""
        return value


@dataclass(frozen=True, kw_only=True)
class PerItem(Held):
    """One entry per item: a tensor (B, ...), a batch such as ``Clouds``, a named tuple of those, or ``None``.

    Attributes:
        size: of one item's part of the tensor; ``None`` where it is checked elsewhere.
        dtype: of the tensor, likewise.
        gap: stands for items without, where others have one; ``None`` where all have or none has.
    """

    size: tuple[int, ...] | None = None
    dtype: torch.dtype | Literal["floating"] | None = None
    gap: float | None = None

    def picked(self, value: Any, batch: Any, numbers: Sequence[int]) -> Any:  # noqa: ANN401
        """The entries of these items."""
        if isinstance(value, tuple):
            return _like(value, (self.picked(part, batch, numbers) for part in value))
        return value if value is None else value[_index_of(value, numbers)]

    def joined(self, values: Sequence[Any], name: str, batches: Sequence[Any]) -> Any:  # noqa: ANN401
        """All entries."""
        if self.gap is not None:
            values = _filled(values, self.gap, batches)
        if not _are_there(values, name, batches):
            return None
        first = values[0]
        if isinstance(first, tuple):
            return _like(first, (self.joined(parts, name, batches) for parts in zip(*values, strict=True)))
        return torch.cat(list(values)) if isinstance(first, Tensor) else type(first).pack(values)

    def check(self, value: Any, name: str, count: int) -> None:  # noqa: ANN401
        """Raise ``ValueError`` where the tensor has another shape or dtype."""
        if self.size is not None and value is not None:
            expect_shape(value, name, (count, *self.size), self.dtype)


@dataclass(frozen=True, kw_only=True)
class Listed(Held):
    """A tuple of one thing per item, such as texts; where ``optional``, an empty one says that there are none.

    Attributes:
        optional: whether it may be empty.
        what: the things, in the words of an error.
        shown: whether tables for people show them.
    """

    optional: bool = False
    what: str = "one item"
    shown: bool = False

    def picked(self, value: Any, batch: Any, numbers: Sequence[int]) -> Any:  # noqa: ANN401
        """The things of these items."""
        return tuple(value[number] for number in numbers) if value else value

    def joined(self, values: Sequence[Any], name: str, batches: Sequence[Any]) -> Any:  # noqa: ANN401
        """The things of all items."""
        return tuple(thing for value in values for thing in value)

    def check(self, value: Any, name: str, count: int) -> None:  # noqa: ANN401
        """Raise ``ValueError`` where there are not as many as items."""
        expected = f"{'none or ' if self.optional else ''}{self.what} per pair ({count})"
        expect(len(value) == count or (self.optional and len(value) == 0), name, expected, len(value))


def held(kind: Held, default: Any = MISSING) -> Any:  # noqa: ANN401
    """A field of a frozen dataclass, declared with what it holds."""
    return field(default=default, metadata={_MARK: kind})


def numbers(*size: int) -> PerItem:
    """One float64 number, or a tensor of this size, per item."""
    return PerItem(size=size, dtype=torch.float64)


def held_by(kind: type) -> dict[str, Held]:
    """What the fields of a class hold, by name, in order; a field that is not declared is shared by all items."""
    if kind not in _HELD_BY:  # a plain dictionary, which torch.compile can look into
        _HELD_BY[kind] = {each.name: each.metadata.get(_MARK, Held()) for each in fields(kind)}
    return _HELD_BY[kind]


_HELD_BY: dict[type, dict[str, Held]] = {}


def offsets_in(batch: Any, name: str) -> Tensor:  # noqa: ANN401
    """The offsets (B+1,) in the field of this name, its own or those of the batch that it holds."""
    value = getattr(batch, name)
    offsets: Tensor = value if isinstance(value, Tensor) else value.offsets
    return offsets


def bounds_of(offsets: Tensor, numbers: Sequence[int]) -> list[tuple[int, int]]:
    """The (begin, end) rows of these items; of one without a look at all others."""
    if len(numbers) == 1:
        begin, end = offsets[numbers[0] : numbers[0] + 2].tolist()
        return [(begin, end)]
    bounds = spans(offsets)
    return [bounds[number] for number in numbers]


def picked_rows(rows: Tensor, bounds: Sequence[tuple[int, int]]) -> Tensor:
    """The rows of these items, each from begin to end; a view where they lie one after another."""
    if all(end == begin for (_, end), (begin, _) in pairwise(bounds)):
        return rows[bounds[0][0] : bounds[-1][1]] if bounds else rows[:0]
    return torch.cat([rows[begin:end] for begin, end in bounds])


def _index_of(value: Any, numbers: Sequence[int]) -> Any:  # noqa: ANN401
    """The index of these items: a slice, whose result is a view, where they follow each other."""
    if all(after == before + 1 for before, after in pairwise(numbers)):
        return slice(numbers[0], numbers[-1] + 1) if numbers else slice(0, 0)
    return torch.tensor(numbers, device=value.device) if isinstance(value, Tensor) else list(numbers)


def _are_there(values: Sequence[Any], name: str, batches: Sequence[Any]) -> bool:
    """Whether a field is there; ``ValueError`` where some batches have it and others have not."""
    have = sum(value is not None for value in values)
    others = len(values) - have
    expected = f"{name} for all {len(values)} {batches[0].noun} or for none"
    expect_in_words(have == 0 or others == 0, name, expected, f"{have} with and {others} without")
    return have > 0


def _filled(values: Sequence[Any], gap: float, batches: Sequence[Any]) -> list[Any]:
    """The values, tensors of ``gap`` in place of those that are missing where another is there."""
    some = next((value for value in values if value is not None), None)
    if some is None:
        return list(values)
    return [
        some.new_full((len(batch), *some.shape[1:]), gap) if value is None else value
        for value, batch in zip(values, batches, strict=True)
    ]


def _like(value: tuple[Any, ...], items: Any) -> Any:  # noqa: ANN401
    """The items as a tuple of the same class, named or plain."""
    return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
