"""Full precision for halves, since geometry needs the digits that a half-precision network drops.

A coordinate of 10 m in bfloat16 is off by 3 cm, and a histogram counts votes to 1 in 256. So descriptors and modules
run outside of autocast, as all public functions do (``torchreg.entry``), on half-precision inputs converted to float32.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.types.clouds import Clouds
from torchreg.types.features import Features

_Function = TypeVar("_Function", bound=Callable[..., Any])

_HALF = (torch.float16, torch.bfloat16)


def full_precision(function: _Function) -> _Function:
    """Make a function, or a module's forward, public, with clouds, features and tensors in float32 or float64."""

    @functools.wraps(function)
    def call(*args: object, **keywords: object) -> Any:  # noqa: ANN401
        wide = [_widened(value) for value in args]
        return function(*wide, **{name: _widened(value) for name, value in keywords.items()})

    return entry(call)  # type: ignore[return-value]


def widened(value: Tensor) -> Tensor:
    """A tensor in half precision as float32, any other as it is; gradients flow."""
    return value.float() if value.dtype in _HALF else value


def _widened(value: object) -> object:
    if isinstance(value, Tensor):
        return widened(value)
    if isinstance(value, Features):
        return replace(value, values=widened(value.values))
    if isinstance(value, Clouds) and value.points.dtype in _HALF:
        return value.to(dtype=torch.float32)
    return value
