"""Orders by several keys."""

from __future__ import annotations

import torch
from torch import Tensor


def lexicographic(*keys: Tensor) -> Tensor:
    """The order (K,) that sorts by the last key, ties by the one before it, and so on."""
    order = keys[0].argsort(stable=True)
    for key in keys[1:]:
        order = order[key[order].argsort(stable=True)]
    return order


def rank(group: Tensor) -> Tensor:
    """Place (K,) of every element within its group; ``group`` (K,) int64 ascends."""
    places = torch.arange(len(group), device=group.device)
    _, number = group.unique_consecutive(return_inverse=True)
    begin = torch.full_like(places, len(group)).scatter_reduce_(0, number, places, "amin")
    return places - begin[number]
