"""Histogram equalization of hue with gradients: a smooth cumulative distribution."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.descriptors.color import HUE_LEVELS
from torchreg.descriptors.soft.arguments import expect_finite
from torchreg.descriptors.soft.votes import bin_shares
from torchreg.errors import expect_floating, expect_shape, fraction
from torchreg.types.packing import checked_offsets, spans


def soft_equalize(hue: Tensor, offsets: Tensor, bandwidth: float = 1.0) -> Tensor:
    """Histogram-equalize hues, every packed cloud by itself, with gradients.

    As ``torchreg.descriptors.color.equalize`` over 256 levels, but a hue passes from one level to the next over a
    ramp (``soft.votes``), both where it is counted and where the map is read. The least hue becomes 0, the
    largest nearly 1.

    Args:
        hue: (P,) in [0, 1].
        offsets: (B+1,) int64.
        bandwidth: in (0, 1], the width of a ramp in levels; narrow ones give ``equalize``.

    Returns:
        (P,) in [0, 1]; a cloud of one hue maps to 0. Gradients flow, of a piecewise smooth function; on the CPU the
        same bits in any batch and number of threads.

    Raises:
        ValueError: shapes that do not fit, or hues or a bandwidth out of their range.
    """
    expect_shape(hue, "hue", ("P",))
    expect_floating(hue, "hue")
    fraction(bandwidth, "bandwidth")
    expect_finite(hue, "hue", unit=True)
    parts = [_equalize_one(hue[begin:end], bandwidth) for begin, end in spans(checked_offsets(offsets, len(hue)))]
    return torch.cat(parts) if parts else hue


def _equalize_one(hue: Tensor, bandwidth: float) -> Tensor:
    if len(hue) == 0:
        return hue
    lower, upper, share = (part[0] for part in bin_shares(hue[None], HUE_LEVELS, bandwidth))
    counts = hue.new_zeros(HUE_LEVELS).index_add(0, lower, 1 - share).index_add(0, upper, share)
    below = counts.cumsum(0)
    mapped = below[lower] * (1 - share) + below[upper] * share
    lowest = mapped.amin()
    return (mapped - lowest) / (len(hue) - lowest).clamp(min=1)
