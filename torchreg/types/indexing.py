"""The items that an index means, as ``batch[...]`` takes it."""

from __future__ import annotations

from collections.abc import Sequence
from operator import index
from typing import Any

import numpy as np
from torch import Tensor


def numbers_of(key: Any, count: int, noun: str) -> list[int]:  # noqa: ANN401
    """The numbers, from 0 to ``count`` - 1, of the items that a key means.

    Args:
        key: a whole number; a slice; whole numbers (K,) or a mask (``count``,), as a tensor, an array or a sequence.
        count: of items.
        noun: what they are called in errors.

    Raises:
        IndexError: a number outside [-count, count), or a mask of another length.
        TypeError: anything else.
    """
    if isinstance(key, slice):
        return list(range(count)[key])
    if isinstance(key, (Tensor, np.ndarray)):
        key = key.tolist()
    listed = [key] if not isinstance(key, Sequence) else list(key)
    if isinstance(key, str) or not all(hasattr(one, "__index__") for one in listed):
        raise TypeError(f"index: expected a number, a slice, numbers or a mask of {noun}, got {key!r}")
    if isinstance(key, Sequence) and listed and all(isinstance(one, (bool, np.bool_)) for one in listed):
        if len(listed) != count:
            raise IndexError(f"index: expected a mask of {count} {noun}, got one of {len(listed)}")
        return [number for number, one in enumerate(listed) if one]
    return [_number(one, count, noun) for one in listed]


def _number(one: Any, count: int, noun: str) -> int:  # noqa: ANN401
    if isinstance(one, (bool, np.bool_)):
        raise TypeError(f"index: expected a number, a slice, numbers or a mask of {noun}, got {one!r}")
    number = index(one)
    if not -count <= number < count:
        raise IndexError(f"index: expected a number from {-count} to {count - 1}, for {count} {noun}, got {number}")
    return number % count
