"""What every public function does before its own work: check its arguments, and step out of torch's modes.

Modes belong to the caller's network, not to geometry. ``torch.autocast`` would multiply coordinates in half precision,
and a default device would take offsets and draws that belong on the CPU away from there. Inside a public function
neither holds, so that its results have the same bits in any mode; afterwards both hold again.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor

from torchreg.arguments import check, parameters_of
from torchreg.errors import expect

Function = TypeVar("Function", bound=Callable[..., Any])

_CPU = torch.device("cpu")
_DEVICES = ("cpu", *(device.type for device in [torch.accelerator.current_accelerator()] if device is not None))


def entry(function: Function) -> Function:
    """Make a function public: arguments checked by its annotations, tensors with values, the same bits in any mode.

    Where a graph is captured (``torch.compile``, ``torch.export``) nothing is checked, and autocast alone is left.
    """

    @functools.wraps(function)
    def call(*args: Any, **words: Any) -> Any:  # noqa: ANN401
        if torch.compiler.is_compiling():
            return without_autocast(function, args, words)
        check(function, args, words)
        _expect_values(function, args, words)
        if torch.get_default_device().type == "cpu":
            return without_autocast(function, args, words)
        with _CPU:
            return without_autocast(function, args, words)

    return call  # type: ignore[return-value]


def without_autocast(function: Callable[..., Any], args: Sequence[Any], words: dict[str, Any]) -> Any:  # noqa: ANN401
    """Call a function outside of ``torch.autocast``, on whatever device that is."""
    for device in _DEVICES:
        if torch.is_autocast_enabled(device):
            with torch.autocast(device, enabled=False):
                return without_autocast(function, args, words)
    return function(*args, **words)


def _expect_values(function: Callable[..., Any], args: Sequence[Any], words: dict[str, Any]) -> None:
    """Refuse tensors on the device ``meta``, and records of such, which have shapes and no values."""
    names = [parameter.name for parameter in parameters_of(function).positional]
    names += ["arguments"] * (len(args) - len(names))
    for name, value in (*zip(names, args, strict=False), *words.items()):
        expect(not _without_values(value), name, "tensors with values", "some on the device meta, which have none")


def _without_values(value: object) -> bool:
    if isinstance(value, Tensor):
        return value.is_meta
    if is_dataclass(value) and not isinstance(value, type):
        return any(isinstance(each, Tensor) and each.is_meta for each in vars(value).values())
    return False
