"""What every public function does before its own work: check its arguments, and step out of torch's modes.

Modes belong to the caller's network, not to geometry. ``torch.autocast`` would multiply coordinates in half precision,
and a default device would take offsets and draws that belong on the CPU away from there. Inside a public function
neither holds, so that its results have the same bits in any mode; afterwards both hold again.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import is_dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor

from torchreg.arguments import check, parameters_of
from torchreg.errors import describe

Function = TypeVar("Function", bound=Callable[..., Any])

_CPU = torch.device("cpu")
_DEVICES = ("cpu", *(device.type for device in [torch.accelerator.current_accelerator()] if device is not None))


def entry(function: Function) -> Function:
    """Make a function public: arguments checked by its annotations, and the same bits in any mode.

    On the device ``meta``, where tensors have shapes alone, it runs as far as no value is read, and says so there.
    Where a graph is captured (``torch.compile``, ``torch.export``) nothing is checked, and autocast alone is left.
    """

    @functools.wraps(function)
    def call(*args: Any, **words: Any) -> Any:  # noqa: ANN401
        if torch.compiler.is_compiling():
            return without_autocast(function, args, words)
        check(function, args, words)
        try:
            if torch.get_default_device().type == "cpu":
                return without_autocast(function, args, words)
            with _CPU:
                return without_autocast(function, args, words)
        except (RuntimeError, IndexError) as error:  # torch's NotImplementedError is a RuntimeError
            _blame_meta(function, args, words, error)
            raise

    return call  # type: ignore[return-value]


def without_autocast(function: Callable[..., Any], args: Sequence[Any], words: dict[str, Any]) -> Any:  # noqa: ANN401
    """Call a function outside of ``torch.autocast``, on whatever device that is."""
    for device in _DEVICES:
        if torch.is_autocast_enabled(device):
            with torch.autocast(device, enabled=False):
                return without_autocast(function, args, words)
    return function(*args, **words)


def _blame_meta(function: Callable[..., Any], args: Sequence[Any], words: dict[str, Any], error: Exception) -> None:
    """Raise ``ValueError`` about the first argument on the device ``meta``, if there is one."""
    names = [parameter.name for parameter in parameters_of(function).positional]
    names += ["arguments"] * (len(args) - len(names))
    for name, value in (*zip(names, args, strict=False), *words.items()):
        meta = next((part for part in _tensors_of(value) if part.is_meta), None)
        if meta is not None:
            what = f"{function.__name__} reads values, which a tensor on the device meta has none of"
            raise ValueError(f"{name}: expected a tensor with values, got {describe(meta)}: {what}") from error


def _tensors_of(value: object) -> Iterable[Tensor]:
    """A tensor, or those of a record or of a sequence of these."""
    if isinstance(value, (list, tuple)):
        return (part for each in value for part in _tensors_of(each))
    parts = vars(value).values() if is_dataclass(value) and not isinstance(value, type) else [value]
    return (part for part in parts if isinstance(part, Tensor))
