"""Hue, saturation and value of every point, and histogram equalization of hue (the paper, section 3.4).

Conversion is kornia's. Equalization replaces a hue by the share of points whose hue is not larger, read off a
histogram of 256 bins as in 8-bit image equalization, so it evens out where on the color circle a scan's hues
crowd. Gray points have no hue; the conversion gives them 0, and the paper's plain rule takes that as it is.
``soft_equalize`` does the same by a smooth cumulative distribution, with gradients.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.descriptors.soft.arguments import expect_finite
from torchreg.descriptors.soft.votes import bin_shares
from torchreg.entry import entry
from torchreg.errors import expect, expect_shape, fraction, one_of
from torchreg.types import Clouds
from torchreg.types.packing import checked_offsets, spans

HUE_LEVELS = 256


def hsv(colors: Tensor) -> Tensor:
    """Hue, saturation and value (P, 3), each in [0, 1], of sRGB colors (P, 3) in [0, 1]; hue 0 for gray.

    Gradients flow.

    Raises:
        ValueError: another shape.
    """
    from kornia.color import rgb_to_hsv

    expect_shape(colors, "colors", ("P", 3))
    image = colors.t()[None, :, :, None]  # (1, 3, P, 1): kornia converts images
    hue, saturation, value = rgb_to_hsv(image)[0, :, :, 0]
    return torch.stack([hue / (2 * math.pi), saturation, value], dim=1)


def equalize(hue: Tensor, offsets: Tensor) -> Tensor:
    """Histogram-equalize hues (P,) in [0, 1], every packed cloud by itself.

    The least occupied level maps to 0, the last to 1; a cloud of one level maps to 0. The map depends on counts alone.
    No gradients.
    """
    parts = [_equalize_one(hue[begin:end]) for begin, end in spans(offsets, hue.shape[0])]
    return torch.cat(parts) if parts else hue


def _equalize_one(hue: Tensor) -> Tensor:
    level = (hue.detach() * HUE_LEVELS).long().clamp_(0, HUE_LEVELS - 1)
    count = level.new_zeros(HUE_LEVELS).scatter_add_(0, level, torch.ones_like(level))
    below = count.cumsum(0)
    lowest = torch.where(count > 0, below, below[-1]).min()  # points on the least occupied level
    span = (below[-1] - lowest).clamp(min=1)
    return ((below - lowest).clamp(min=0).to(hue.dtype) / span.to(hue.dtype))[level]


@entry
def soft_equalize(hue: Tensor, offsets: Tensor, bandwidth: float = 1.0) -> Tensor:
    """Histogram-equalize hues, every packed cloud by itself, with gradients.

    As ``equalize``, but a hue passes from one level to the next over a
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

    Example:
        >>> import torch, torchreg as tr
        >>> hue = torch.tensor([0.1, 0.1, 0.2, 0.9])
        >>> tr.soft_equalize(hue, torch.tensor([0, 4])).shape
        torch.Size([4])
    """
    expect_shape(hue, "hue", ("P",), "floating")
    fraction(bandwidth, "bandwidth")
    expect_finite(hue, "hue", unit=True)
    count = hue.shape[0]
    every = spans(checked_offsets(offsets, count), count)
    parts = [_soft_equalize_one(hue[begin:end], bandwidth) for begin, end in every]
    return torch.cat(parts) if parts else hue


def _soft_equalize_one(hue: Tensor, bandwidth: float) -> Tensor:
    if hue.shape[0] == 0:
        return hue
    lower, upper, share = (part[0] for part in bin_shares(hue[None], HUE_LEVELS, bandwidth))
    counts = hue.new_zeros(HUE_LEVELS).index_add(0, lower, 1 - share).index_add(0, upper, share)
    below = counts.cumsum(0)
    mapped = below[lower] * (1 - share) + below[upper] * share
    lowest = mapped.amin()
    return (mapped - lowest) / (hue.shape[0] - lowest).clamp(min=1)


def color_values(clouds: Clouds, equalization: str = "cloud") -> Tensor:
    """Hue, saturation and value (P, 3) of packed clouds, hue equalized per ``"cloud"`` or not (``"none"``).

    For joint equalization over pairs see ``joint_color_values``. Raises ``ValueError`` without colors, or for another
    name.
    """
    one_of(equalization, "equalization", ("none", "cloud"))
    values = hsv(colors_of(clouds))
    if equalization == "none":
        return values
    return torch.cat([equalize(values[:, 0], clouds.offsets)[:, None], values[:, 1:]], dim=1)


def joint_color_values(source: Clouds, target: Clouds) -> tuple[Tensor, Tensor]:
    """Hue, saturation and value (P, 3) of both clouds of every pair, hue equalized by one map for the two.

    Raises ``ValueError`` without colors, or for different numbers of clouds.
    """
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    of_source, of_target = hsv(colors_of(source)), hsv(colors_of(target))
    pairs = list(zip(spans(source.offsets), spans(target.offsets), strict=True))
    for (i, j), (k, m) in pairs:
        both = _equalize_one(torch.cat([of_source[i:j, 0], of_target[k:m, 0]]))
        of_source[i:j, 0], of_target[k:m, 0] = both[: j - i], both[j - i :]
    return of_source, of_target


def colors_of(clouds: Clouds) -> Tensor:
    """The colors of clouds; ``ValueError`` where they are missing or not finite."""
    if clouds.colors is None:
        raise ValueError("cloud: expected colors, got none")
    if torch.compiler.is_compiling():  # where values are not known
        return clouds.colors
    broken = ~torch.isfinite(clouds.colors).all(dim=1)
    if bool(broken.any()):
        raise ValueError(f"colors: expected finite numbers, got {int(broken.sum())} points without")
    return clouds.colors
