"""Local color contrast: how much each color channel varies around a point, near and far.

For every channel and for the supports N (all of the neighborhood) and n (its inner part, radius 0.4 of it):

    std(n) / (mean(n) + e),   std(N) / (mean(N) + e),   (mean(n) - mean(N)) / (mean(N) + e),   e = 0.05

Divided by the local mean, they do not change when a light is dimmed or a white balance scales a channel (but
for e, which keeps dark places from blowing up noise). A constant is appended, so that scaling the row to unit
length in ``fuse`` leaves the amount of contrast visible: flat and lively surfaces differ in direction.

On the colored real pairs this block tells points apart better than differences of hue alone do: where most of
a scene is gray, hue is noise and brightness is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.descriptors.color import colors_of
from torchreg.descriptors.descriptor import Descriptor
from torchreg.errors import expect, positive
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather
from torchreg.types import Clouds, Features, Neighborhoods

CONTRAST_SIZE = 10
INNER = 0.4
_FLOOR = 0.05
_CONSTANT = 0.3


def contrast(cloud: Clouds, near: Neighborhoods, radius: float | Tensor) -> Features:
    """Contrast of every point.

    Args:
        cloud: points and colors; P rows.
        near: the support of every point, the point itself counted.
        radius: meters, of that support; the inner one has 0.4 of it. A number, or one per point (P,).

    Returns:
        Features of one block ("contrast", 10). A point without a neighbor besides itself gets a zero row and
        is not valid. The same bits for any chunking, batch and number of threads. No gradients.

    Raises:
        ValueError: no colors, or shapes that do not fit.
    """
    colors = colors_of(cloud)
    count = len(colors)
    expect(len(near) == count, "near", f"neighborhoods of {count} points", len(near))
    if isinstance(radius, Tensor):
        expect(radius.shape == (count,), "radius", f"a number or one per point ({count},)", radius)
        inner = (INNER * radius).square().to(near.sq_distance)[:, None]
    else:
        inner = torch.as_tensor((INNER * positive(radius, "radius")) ** 2).to(near.sq_distance).expand(count, 1)
    channels = [channel.contiguous() for channel in colors.unbind(1)]
    out = colors.new_empty(count, CONTRAST_SIZE)
    for rows in row_chunks(count, near.max_neighbors):
        valid = near.valid[rows]
        index = near.index[rows]
        whole = valid.to(colors.dtype)
        core = (valid & (near.sq_distance[rows] < inner[rows])).to(colors.dtype)
        columns = []
        for channel in channels:
            value = gather(channel, index) - channel[rows, None]  # against the point's own, to lose no digits
            own = channel[rows]
            near_mean, near_spread = _moments(value, core)
            far_mean, far_spread = _moments(value, whole)
            far_level = own + far_mean + _FLOOR
            near_level = own + near_mean + _FLOOR
            columns += [near_spread / near_level, far_spread / far_level, (near_mean - far_mean) / far_level]
        described = (whole.sum(dim=1) > 1).to(colors.dtype)
        columns.append(torch.full_like(columns[0], _CONSTANT))
        torch.mul(torch.stack(columns, dim=1), described[:, None], out=out[rows])
    return Features(out, cloud.offsets, (("contrast", CONTRAST_SIZE),), valid=(out != 0).any(dim=1))


@dataclass(frozen=True, kw_only=True)
class Contrast(Descriptor):
    """``torchreg.contrast``: spread and shift of brightness per channel, near and far."""

    name: ClassVar[str] = "contrast"
    needs_colors: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    @property
    def reach(self) -> float:
        """Meters: a point reads its neighbors alone."""
        return self.radius

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.contrast``."""
        return contrast(cloud, near, self.radius if near.radius is None else near.radius)


def _moments(value: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (r,) of values (r, K) where the weight is 1."""
    share = 1 / weight.sum(dim=1).clamp(min=1)
    weighted = value * weight
    mean = weighted.sum(dim=1) * share
    return mean, ((weighted * value).sum(dim=1) * share - mean * mean).clamp(min=0).sqrt()
