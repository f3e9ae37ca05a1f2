"""Checks of the arguments of soft binning."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect, expect_in_words, expect_shape, fraction, one_of
from torchreg.geometry.numerics.derivatives import transformed
from torchreg.types import Neighborhoods

BINNINGS = ("hard", "soft")


def expect_binning(binning: str, bandwidth: float, *, edges: Tensor | None, neighbor_weights: Tensor | None) -> None:
    """Refuse an unknown binning, a bandwidth out of (0, 1], and options that the binning would not read."""
    one_of(binning, "binning", BINNINGS)
    fraction(bandwidth, "bandwidth")
    if binning == "hard":
        expect(bandwidth == 1, "bandwidth", "1 with hard binning, which does not read it", bandwidth)
        expect(edges is None, "edges", "None with hard binning, whose bins are equal", edges)
        expect(neighbor_weights is None, "neighbor_weights", "None with hard binning, which counts", neighbor_weights)


def expect_finite(value: Tensor, name: str, *, unit: bool = False) -> None:
    """Refuse numbers that are not finite, or not in [0, 1] where ``unit``.

    Inside compilation and transforms, where no value can be read, nothing is checked.
    """
    if transformed(value):
        return
    known = value.detach()
    fits = (known >= 0) & (known <= 1) if unit else torch.isfinite(known)
    expect_in_words(bool(fits.all()), name, "numbers in [0, 1]" if unit else "finite numbers", "others too")


def bin_edges(edges: Tensor | None, rows: int, bins: int, like: Tensor) -> Tensor | None:
    """Edges (rows, bins + 1) in the dtype of ``like``; gradients flow on."""
    if edges is None:
        return None
    expect_shape(edges, "edges", (rows, bins + 1), "floating")
    if not torch.compiler.is_compiling():
        ascending = bool((edges.detach()[:, 1:] > edges.detach()[:, :-1]).all())
        expect(ascending, "edges", "numbers that ascend in every row", edges)
        ends = bool((edges.detach()[:, 0] == 0).all()) and bool((edges.detach()[:, -1] - 1).abs().max() < 1e-5)
        expect(ends, "edges", "rows from 0 to 1", edges)
    return edges.to(like)


def slot_weights(weights: Tensor | None, near: Neighborhoods, like: Tensor) -> Tensor | None:
    """Neighbor weights (P, K) in the dtype of ``like``; gradients flow on."""
    if weights is None:
        return None
    expect_shape(weights, "neighbor_weights", tuple(near.index.shape), "floating")
    if not torch.compiler.is_compiling():
        known = weights.detach().to(like)
        allowed = bool((torch.isfinite(known) & (known >= 0) | ~near.valid).all())
        expect(allowed, "neighbor_weights", f"numbers not below 0 that are finite in {like.dtype}", weights)
    return weights.to(like)
