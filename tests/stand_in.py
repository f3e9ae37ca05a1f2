"""A stand-in for a GPU, so that what runs on one can be tried where there is none.

Tensors on it say that they lie on another device, PyTorch's ``meta``, but keep their numbers in memory. They refuse
what a GPU refuses (other operands on the CPU, NumPy, Open3D) and count what makes a GPU wait for the host. So the very
functions run that would run on a GPU, none that are compiled for the CPU, and their numbers can be compared.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

NAME = "meta"

_SIZED_BY_VALUES = (
    "nonzero",
    "masked_select",
    "_unique2",
    "unique_dim",
    "unique_consecutive",
    "bincount",
    "equal",
)
_INDEXING = ("index", "index_put", "index_put_", "_index_put_impl_")  # indices may lie on the CPU
_COPIES = ("copy_", "_to_copy")


class Shadow(Tensor):
    """A tensor on the stand-in. Where PyTorch would not look at the values of a meta tensor, it does here."""

    held: Tensor

    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, held: Tensor) -> Shadow:
        shadow = Tensor._make_wrapper_subclass(
            cls, held.shape, strides=held.stride(), storage_offset=held.storage_offset(), dtype=held.dtype, device=NAME
        )
        shadow.held = held
        return shadow

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise RuntimeError(f"{func}: a tensor on the stand-in, used outside of it")

    def tolist(self) -> Any:
        return self.cpu().tolist()

    def new_tensor(self, data: Any, *, dtype: torch.dtype | None = None) -> Tensor:
        return torch.tensor(data, dtype=dtype or self.dtype).to(NAME)

    def __getitem__(self, index: Any) -> Tensor:
        return super().__getitem__(_without_lists(index))

    def __setitem__(self, index: Any, value: Any) -> None:
        super().__setitem__(_without_lists(index), value)

    def __repr__(self, **_: Any) -> str:
        return f"{type(self).__name__}({tuple(self.shape)}, {self.dtype})"


class StandIn(TorchDispatchMode):
    """Within this context ``Tensor.to("meta")`` puts tensors on the stand-in.

    Attributes:
        transfers: how often each kind of operation read a value back, sized a tensor by values, or copied from the
            stand-in to the CPU.
    """

    def __init__(self) -> None:
        super().__init__()
        self.transfers: Counter[str] = Counter()
        self._constructors = _Constructors()

    def __enter__(self) -> StandIn:
        self._constructors.__enter__()
        super().__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._constructors.__exit__(*error)

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run on what the tensors hold; refuse and count as a GPU would."""
        kwargs = dict(kwargs or {})
        name = func.overloadpacket.__name__
        given = [value for value in tree_leaves((args, kwargs)) if isinstance(value, Tensor)]
        shadows = [value for value in given if isinstance(value, Shadow)]
        asked = kwargs.get("device")
        there = bool(shadows) if asked is None else torch.device(asked).type == NAME  # where the result lies
        if not shadows and not there:
            return func(*args, **kwargs)
        if len(shadows) < len(given) and name not in _COPIES:
            _refuse_others(name, args, given)
        if name == "copy_":
            there = isinstance(args[0], Shadow)
        if shadows and (not there or name in _SIZED_BY_VALUES or _is_read(name, args, kwargs)):
            self.transfers[name] += 1
        if asked is not None and there:
            kwargs["device"] = torch.device("cpu")
        plain_args, plain_kwargs = tree_map_only(Shadow, lambda shadow: shadow.held, (args, kwargs))
        result = func(*plain_args, **plain_kwargs)
        if name == "copy_":
            return args[0]
        return _shown(result, {id(shadow.held): shadow for shadow in shadows}) if there else result


class _Constructors(TorchFunctionMode):
    """Lets ``torch.tensor`` look at the numbers that it is given for the stand-in."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        asked = kwargs.get("device")
        if func in (torch.tensor, torch.as_tensor) and asked is not None and torch.device(asked).type == NAME:
            return func(*args, **{**kwargs, "device": torch.device("cpu")}).to(NAME)
        return func(*args, **kwargs)


def _shown(result: Any, known: dict[int, Shadow]) -> Any:
    """The results as tensors on the stand-in, one that was changed in place as the very one that was given."""
    return tree_map_only(Tensor, lambda held: known[id(held)] if id(held) in known else Shadow(held), result)


def _refuse_others(name: str, args: Any, given: list[Tensor]) -> None:
    """Raise where an operand lies on the CPU and is more than one number, as PyTorch does for a GPU."""
    others = [value for value in given if not isinstance(value, Shadow) and value.dim() > 0]
    if name in _INDEXING:
        others = [value for value in others if value is args[0] or (len(args) > 2 and value is args[2])]
    if others:
        raise RuntimeError(f"{name}: expected all tensors to be on the same device, got {others[0].shape} on the cpu")


def _is_read(name: str, args: Any, kwargs: dict[str, Any]) -> bool:
    """Whether an operation reads one number back, finds the rows of a mask, or repeats rows by unknown numbers."""
    by_mask = name in _INDEXING and any(index is not None and index.dtype == torch.bool for index in args[1])
    repeats = name == "repeat_interleave" and kwargs.get("output_size") is None
    return by_mask or repeats or name == "_local_scalar_dense"


def _without_lists(index: Any) -> Any:
    if isinstance(index, tuple):
        return tuple(map(_without_lists, index))
    if not isinstance(index, list):
        return index
    return torch.tensor(index) if index else torch.zeros(0, dtype=torch.int64)
