"""A stand-in for a GPU, so that what runs on one can be tried where there is none.

Tensors on it say that they lie on another device, PyTorch's ``meta``, but keep their numbers in memory. They refuse what
a GPU refuses (another operand on the CPU, NumPy, Open3D) and count what makes a GPU wait for the host. So the very
functions run that would run on a GPU, none that are compiled for the CPU, and their numbers can be compared.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map_only

NAME = "meta"

_SIZED_BY_VALUES = ("nonzero", "masked_select", "_unique2", "unique_dim", "unique_consecutive", "bincount", "equal")
_INDEXING = ("index", "index_put", "index_put_", "_index_put_impl_")  # indices may lie on the CPU


class Shadow(Tensor):
    """A tensor on the stand-in."""

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

    def __repr__(self, **_: Any) -> str:
        return f"{type(self).__name__}({tuple(self.shape)}, {self.dtype})"


class StandIn(TorchDispatchMode):
    """Within this context ``Tensor.to("meta")`` puts tensors on the stand-in.

    Attributes:
        transfers: how often each kind of operation read a value back, sized a tensor by values, or copied from the
            stand-in to the CPU.
        uploads: how many copies went from the CPU to the stand-in.
    """

    def __init__(self) -> None:
        super().__init__()
        self.transfers: Counter[str] = Counter()
        self.uploads = 0
        self._construct = _Constructors()

    def __enter__(self) -> StandIn:
        self._construct.__enter__()
        super().__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._construct.__exit__(*error)

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run on what the tensors hold; refuse and count as a GPU would."""
        kwargs = dict(kwargs or {})
        name = func.overloadpacket.__name__
        given = [value for value in tree_flatten((args, kwargs))[0] if isinstance(value, Tensor)]
        shadows = [value for value in given if isinstance(value, Shadow)]
        asked = kwargs.get("device")
        target = None if asked is None else torch.device(asked).type
        if target == NAME:
            kwargs["device"] = torch.device("cpu")
        if not shadows and target != NAME:
            return func(*args, **kwargs)
        self._count(name, args, shadows, target)
        if shadows and len(shadows) < len(given) and name not in ("copy_", "_to_copy"):
            _refuse_others(name, args, given)
        plain_args, plain_kwargs = tree_map_only(Shadow, lambda shadow: shadow.held, (args, kwargs))
        result = func(*plain_args, **plain_kwargs)
        stays = target is None if shadows else False
        if name == "copy_":
            return args[0]
        if not (stays or target == NAME):
            return result
        known = {id(shadow.held): shadow for shadow in shadows}
        return tree_map_only(Tensor, lambda held: known[id(held)] if id(held) in known else Shadow(held), result)

    def _count(self, name: str, args: Any, shadows: list[Shadow], target: str | None) -> None:
        if name == "copy_":
            here, there = (isinstance(value, Shadow) for value in args[:2])
            self.uploads += here and not there
            self.transfers["copy"] += there and not here
        elif name == "_to_copy" and target is not None:
            self.uploads += target == NAME and not shadows
            self.transfers["copy"] += target != NAME and bool(shadows)
        elif shadows and name == "_local_scalar_dense":
            self.transfers["read"] += 1
        elif shadows and (name in _SIZED_BY_VALUES or _indexes_by_mask(name, args) or _repeats_by_values(name, args)):
            self.transfers[name] += 1
        self.transfers += Counter()  # without the zeros


class _Constructors(TorchFunctionMode):
    """PyTorch makes tensors out of numbers on its meta device without looking at the numbers."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        asked = kwargs.get("device")
        if func in (torch.tensor, torch.as_tensor) and asked is not None and torch.device(asked).type == NAME:
            return func(*args, **{**kwargs, "device": torch.device("cpu")}).to(NAME)
        if func is Tensor.new_tensor and isinstance(args[0], Shadow):
            return torch.tensor(*args[1:], **{"dtype": args[0].dtype, **kwargs}).to(NAME)
        return func(*args, **kwargs)


def _refuse_others(name: str, args: Any, given: list[Tensor]) -> None:
    """Raise where an operand lies on the CPU and is more than one number, as PyTorch does for a GPU."""
    others = [value for value in given if not isinstance(value, Shadow) and value.dim() > 0]
    if name in _INDEXING:
        others = [value for value in others if value is args[0] or (len(args) > 2 and value is args[2])]
    if others:
        raise RuntimeError(f"{name}: expected all tensors to be on the same device, got one of {others[0].shape} on cpu")


def _indexes_by_mask(name: str, args: Any) -> bool:
    return name in _INDEXING and any(index is not None and index.dtype == torch.bool for index in args[1])


def _repeats_by_values(name: str, args: Any) -> bool:
    return name == "repeat_interleave"
