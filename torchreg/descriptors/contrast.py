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

from torchreg.arguments import checked_record
from torchreg.descriptors.color import colors_of
from torchreg.descriptors.descriptor import Descriptor, largest_entries
from torchreg.errors import expect, positive
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather
from torchreg.geometry.numerics.sums import NEIGHBOR_LANES, lane_sums
from torchreg.native import call, native, rows
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.precision import full_precision

CONTRAST_SIZE = 10
INNER = 0.4
_FLOOR = 0.05
_CONSTANT = 0.3


@full_precision
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

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3), colors=torch.rand(50, 3))
        >>> near = tr.neighbors(cloud, radius=0.5, max_neighbors=20)
        >>> tr.contrast(cloud, near, radius=0.5).values.shape
        torch.Size([50, 10])
    """
    colors = colors_of(cloud)
    count = len(colors)
    expect(len(near) == count, "near", f"neighborhoods of {count} points", len(near))
    if isinstance(radius, Tensor):
        expect(radius.shape == (count,), "radius", f"a number or one per point ({count},)", radius)
        inner = (INNER * radius).square().to(near.sq_distance)[:, None]
    else:
        square = torch.as_tensor((INNER * positive(radius, "radius")) ** 2, dtype=torch.float32)
        inner = square.to(near.sq_distance).expand(count, 1)
    values = _contrast(colors, near, inner)
    return Features(values, cloud.offsets, (("contrast", CONTRAST_SIZE),), valid=largest_entries(values) != 0)


@checked_record
@dataclass(frozen=True, kw_only=True)
class Contrast(Descriptor):
    """``torchreg.contrast``: spread and shift of brightness per channel, near and far.

    Example:
        >>> import torchreg as tr
        >>> options = tr.RegistrationOptions(descriptors=(tr.Contrast(radius=0.5),), weights=(1.0,))
        >>> options.descriptors[0].name, options.descriptors[0].needs_colors
        ('contrast', True)
    """

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


def _contrast(colors: Tensor, near: Neighborhoods, inner: Tensor) -> Tensor:
    """Contrast (P, 10) of every point; ``inner`` (P, 1) is the square of the radius of its inner support."""
    single = colors.dtype == near.sq_distance.dtype == torch.float32
    if native(colors, near.index, near.valid, near.sq_distance) and single:
        return _contrast_compiled(colors, near, inner)
    channels = [channel.contiguous() for channel in colors.detach().unbind(1)]
    out = colors.new_empty(len(colors), CONTRAST_SIZE)
    for part in row_chunks(len(colors), near.max_neighbors):
        valid = near.valid[part]
        index = near.index[part]
        whole = valid.to(colors.dtype)
        core = (valid & (near.sq_distance[part] < inner[part])).to(colors.dtype)
        columns = []
        for channel in channels:
            value = gather(channel, index) - channel[part, None]  # against the point's own, to lose no digits
            own = channel[part]
            near_mean, near_spread = _moments(value, core)
            far_mean, far_spread = _moments(value, whole)
            far_level = own + far_mean + _FLOOR
            near_level = own + near_mean + _FLOOR
            columns += [near_spread / near_level, far_spread / far_level, (near_mean - far_mean) / far_level]
        described = (whole.sum(dim=1) > 1).to(colors.dtype)
        columns.append(torch.full_like(columns[0], _CONSTANT))
        torch.mul(torch.stack(columns, dim=1), described[:, None], out=out[part])
    return out


def _contrast_compiled(colors: Tensor, near: Neighborhoods, inner: Tensor) -> Tensor:
    """As ``_contrast``."""
    out = colors.new_empty(len(colors), CONTRAST_SIZE)
    slots = *rows(near.index), *rows(near.valid), *rows(near.sq_distance)
    sizes = len(colors), near.max_neighbors
    call("contrast", colors.detach().contiguous(), *slots, inner.contiguous(), *sizes, _FLOOR, _CONSTANT, out)
    return out


def _moments(value: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (r,) of values (r, K) where the weight is 1."""
    share = 1 / weight.sum(dim=1).clamp(min=1)
    weighted = value * weight
    mean = lane_sums(weighted, NEIGHBOR_LANES) * share
    variance = (lane_sums(weighted * value, NEIGHBOR_LANES) * share - mean * mean).clamp(min=0)
    # by the reciprocal root: torch's square root on the CPU is not the nearest number
    return mean, variance * variance.clamp(min=torch.finfo(variance.dtype).tiny).rsqrt()
