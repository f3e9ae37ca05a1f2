"""Full precision under autocast, since geometry needs the digits that a half-precision network drops.

A coordinate of 10 m in bfloat16 is off by 3 cm, and a histogram counts votes to 1 in 256. So modules run outside of
autocast, on half-precision inputs converted to float32.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from torchreg.types import Clouds, Features

_Forward = TypeVar("_Forward", bound=Callable[..., Any])

_HALF = (torch.float16, torch.bfloat16)


def full_precision(forward: _Forward) -> _Forward:
    """Run a module's forward outside of autocast, with clouds, features and tensors in float32 or float64."""

    @functools.wraps(forward)
    def call(module: torch.nn.Module, *args: object, **keywords: object) -> Any:  # noqa: ANN401
        wide = [_widened(value) for value in args]
        named = {name: _widened(value) for name, value in keywords.items()}
        device_type = _device_type((*args, *keywords.values()))
        if not (torch.amp.is_autocast_available(device_type) and torch.is_autocast_enabled(device_type)):
            return forward(module, *wide, **named)
        with torch.autocast(device_type, enabled=False):
            return forward(module, *wide, **named)

    return call  # type: ignore[return-value]


def widened(value: Tensor) -> Tensor:
    """A tensor in half precision as float32, any other as it is; gradients flow."""
    return value.float() if value.dtype in _HALF else value


def _device_type(args: tuple[object, ...]) -> str:
    first = args[0] if args else None
    if isinstance(first, Clouds):
        return first.device.type
    value = first.values if isinstance(first, Features) else first
    return value.device.type if isinstance(value, Tensor) else "cpu"


def _widened(value: object) -> object:
    if isinstance(value, Tensor):
        return widened(value)
    if isinstance(value, Features):
        return replace(value, values=widened(value.values))
    if isinstance(value, Clouds) and value.points.dtype in _HALF:
        return value.to(dtype=torch.float32)
    return value
