"""Checks of arguments whose messages name the argument, the expected and the received value."""

from __future__ import annotations

from dataclasses import is_dataclass
from numbers import Integral, Real
from typing import Literal

import numpy as np
import torch
from torch import Tensor

LARGEST_NUMBER = 1e18
"""A length, threshold or temperature is no larger: its square is finite in float32 too."""

LARGEST_INTEGER = 2**63 - 1
"""A count is no larger: tensors keep it in 64 bits."""


class CloudFileError(ValueError):
    """A file that cannot be read as a point cloud; the message names the file and what is wrong with it."""


class ArgumentTypeError(TypeError, ValueError):
    """An argument of a wrong type: a ``TypeError``, and a ``ValueError`` as everything else wrong with arguments is."""


def expect(condition: bool, name: str, expected: str, received: object) -> None:
    """Raise ``ValueError`` with the argument's name, the expected and the received value, unless ``condition``."""
    if not condition:
        raise ValueError(f"{name}: expected {expected}, got {describe(received)}")


def expect_in_words(condition: bool, name: str, expected: str, received: str) -> None:
    """As ``expect``, where what came is said in words, which stand without quotes: ``got 3 clouds``."""
    if not condition:
        raise ValueError(f"{name}: expected {expected}, got {received}")


def describe(value: object) -> str:
    """The shape, dtype and device of a tensor, the ``repr`` of anything else (shortened)."""
    if isinstance(value, Tensor):
        return f"{tuple(value.shape)} {str(value.dtype).removeprefix('torch.')} on {value.device}"
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def described_with_type(value: object) -> str:
    """The same, and the type where the ``repr`` does not show it; of a record the type alone."""
    if isinstance(value, Tensor):
        return f"a tensor {describe(value)}"
    if is_dataclass(value):
        return type(value).__name__
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} {value.dtype}"
    return describe(value) if value is None or isinstance(value, str) else f"{describe(value)} ({type(value).__name__})"


def expect_shape(
    value: Tensor,
    name: str,
    shape: tuple[int | str, ...],
    dtype: torch.dtype | Literal["floating"] | None = None,
    device: torch.device | None = None,
) -> None:
    """Check the type and shape of a tensor, and its dtype and device where these are given.

    A string in ``shape`` names a free dimension; the dtype ``"floating"`` is any of real floating-point numbers.
    """
    if not isinstance(value, Tensor):
        raise ArgumentTypeError(f"{name}: expected a tensor {_words_of(shape)}, got {type(value).__name__}")
    fits = value.ndim == len(shape) and all(
        isinstance(want, str) or want == have for want, have in zip(shape, value.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"{name}: expected {_words_of(shape)}, got {tuple(value.shape)}")
    if dtype == "floating":
        expect_floating(value, name)
    elif dtype is not None:
        expect_dtype(value, name, dtype)
    if device is not None:
        expect_device(value, name, device)


def _words_of(shape: tuple[int | str, ...]) -> str:
    """A shape as Python writes it; made only for a message, since compilers cannot look into it."""
    return "(" + ", ".join(str(size) for size in shape) + ("," if len(shape) == 1 else "") + ")"


def expect_floating(value: Tensor, name: str) -> None:
    """Check that a tensor holds real floating-point numbers."""
    expect(value.is_floating_point(), name, "a floating-point tensor", value)


def expect_dtype(value: Tensor, name: str, dtype: torch.dtype) -> None:
    """Check the dtype of a tensor."""
    expect(value.dtype == dtype, name, str(dtype).removeprefix("torch."), value)


def expect_device(value: Tensor, name: str, device: torch.device) -> None:
    """Check that a tensor lies on ``device``."""
    expect(value.device == device, name, f"a tensor on {device}", value)


def positive(value: float, name: str) -> float:
    """Return ``value`` if it is a number above zero, at most ``LARGEST_NUMBER``, else raise ``ValueError``."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    expect(number and 0 < value < float("inf"), name, "a finite number above 0", value)
    expect(value <= LARGEST_NUMBER, name, f"a number above 0, at most {LARGEST_NUMBER:g}", value)
    return float(value)


def finite(value: float, name: str) -> float:
    """Return ``value`` if it is a number of at most ``LARGEST_NUMBER`` in size, else raise ``ValueError``."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    expect(number and abs(value) < float("inf"), name, "a finite number", value)
    expect(abs(value) <= LARGEST_NUMBER, name, f"a number of at most {LARGEST_NUMBER:g} in size", value)
    return float(value)


def fraction(value: float, name: str, *, zero: bool = False) -> float:
    """Return ``value`` if it is in (0, 1], or in [0, 1] where ``zero`` is allowed, else raise ``ValueError``."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    legal = number and (0 <= value <= 1 if zero else 0 < value <= 1)
    expect(legal, name, "a number in [0, 1]" if zero else "a number in (0, 1]", value)
    return float(value)


def at_least(value: int, name: str, least: int) -> int:
    """Return ``value`` if it is an integer of at least ``least``, else raise ``ValueError``."""
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    expect(whole and value >= least, name, f"an integer of at least {least}", value)
    expect(value <= LARGEST_INTEGER, name, f"an integer of at most {LARGEST_INTEGER}", value)
    return value


def one_of(value: str, name: str, choices: tuple[str, ...]) -> str:
    """Return ``value`` if it is among ``choices``, else raise ``ValueError``."""
    expect(value in choices, name, "one of " + ", ".join(map(repr, choices)), value)
    return value
