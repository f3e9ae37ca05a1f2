"""What the clouds themselves say of a pose, beyond the matches it was found from.

Looked at from both sides: which points of one scan have a partner in the other (overlap), whether the surfaces
face the same way there (normals), whether their colors go together up to brightness and contrast of every channel
(colors), and whether one scan stands where the other scanner saw free space (conflict).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.verification.free_space import RangeImages, sight
from torchreg.verification.information import strengths
from torchreg.verification.side import Side, gathered, partners, rotated
from torchreg.verification.sums import padded, row_sums

_LEAST_VARIANCE = 1e-5  # of a channel in [0, 1]: below it, the channel is one gray value and its rounding

_STRIDE = 3  # of the points that tell the strength

_ELEMENTS = 1 << 15  # points looked at in one go: what is made of them stays in the cache


class Evidence(NamedTuple):
    """Of H poses, (H,) float64 each.

    Attributes:
        overlap: share of points with a partner nearer than the threshold, the mean over both directions.
        closeness: mean over those partners of 1 - (distance / threshold)^2; 0 where there are none.
        normals: mean cosine between the normals of partners, its size alone where a viewpoint is not known; NaN
            without normals or partners.
        colors: correlation of the colors of partners; NaN without colors.
        strength: how evenly the surfaces of partners hold the pose (``information.strengths``); 0 for one plane.
        conflict: of the points at or before a surface that the other scanner saw, the share before it, in free
            space; NaN without viewpoints.
    """

    overlap: Tensor
    closeness: Tensor
    normals: Tensor
    colors: Tensor
    strength: Tensor
    conflict: Tensor

    def take(self, index: Tensor | slice) -> Evidence:
        """The poses ``index`` (K,), in that order."""
        return Evidence(*(value[index] for value in self))


def evidence(
    source: Side, target: Side, pair: Tensor, rotation: Tensor, translation: Tensor, threshold: Tensor
) -> Evidence:
    """Weigh poses of G pairs, all of them in step; a pose's numbers do not depend on what stands beside it.

    Args:
        source: of G pairs.
        target: likewise.
        pair: (H,) int64, ascending, which pair each pose belongs to.
        rotation: (H, 3, 3) float64.
        translation: (H, 3) float64, meters: x_target = R x_source + t in the frames of the points.
        threshold: (G,) float64, meters.
    """
    back = rotation.transpose(-1, -2)
    home = -(back * translation[:, None, :]).sum(dim=-1)
    forth = _one_way(source, target, pair, rotation, translation, threshold)
    return Evidence(*map(_mean, forth, _one_way(target, source, pair, back, home, threshold)))


def _one_way(
    source: Side, target: Side, pair: Tensor, rotation: Tensor, translation: Tensor, threshold: Tensor
) -> Evidence:
    parts = [
        _of_rows(source, target, pair[rows], rotation[rows].float(), translation[rows].float(), threshold)
        for rows in row_chunks(len(pair), source.real.shape[1], _ELEMENTS)
    ]
    return Evidence(*(torch.cat(values) for values in zip(*parts, strict=True)))


def _of_rows(source: Side, target: Side, pair: Tensor, R: Tensor, t: Tensor, threshold: Tensor) -> Evidence:
    """As ``_one_way``, of a few poses (r, 3, 3), (r, 3), float32."""
    limit = threshold[pair]  # (r,)
    square_limit = limit.square().float()[:, None]
    moved = rotated(R, source.points[:, pair]).add_(t.t()[..., None])  # (3, r, L)
    real = source.real[pair]
    found = partners(target, pair, moved, real)
    close = found.square < square_limit  # (r, L)
    count = close.sum(dim=1).double()
    nothing = torch.full_like(count, float("nan"))
    some = count.clamp(min=1)
    closeness = _over(1 - found.square / square_limit, close) / some
    normals, colors, conflict, strength = nothing, nothing, nothing, torch.zeros_like(count)
    if source.normals is not None and target.all_normals is not None:
        facing = gathered(target.all_normals, found.row)
        x, y, z = rotated(R, source.normals[:, pair]).mul_(facing).unbind(0)
        cosine = x.add_(y).add_(z)
        known = (source.faced & target.faced)[pair, None]
        cosine = torch.where(known, cosine, cosine.abs())  # which side a surface faces may not be known
        normals = torch.where(count > 0, _over(cosine, close) / some, nothing)
        strength = strengths(*(_thinned(values) for values in (moved, facing, close)))
    if source.colors is not None and target.all_colors is not None:
        colors = _correlation(source.colors[:, pair], gathered(target.all_colors, found.row), close)
    if target.images is not None:
        conflict = _conflict(target.images, target.image[pair], moved, real, limit)
    return Evidence(count / source.counts[pair].clamp(min=1), closeness, normals, colors, strength, conflict)


def _conflict(images: RangeImages, which: Tensor, moved: Tensor, real: Tensor, limit: Tensor) -> Tensor:
    """Share (r,) of the points moved (3, r, L) that stand in free space; NaN without an image, ``which`` is -1."""
    seen = sight(images, which.clamp(min=0), moved, 2 * limit)
    real = real & (which >= 0)[:, None]
    before, on = (seen.before & real).sum(dim=1).double(), (seen.on & real).sum(dim=1).double()
    return torch.where(before + on > 0, before / (before + on).clamp(min=1), float("nan"))


def _correlation(one: Tensor, other: Tensor, close: Tensor) -> Tensor:
    """Correlation (r,) of colors (3, r, L) over the points that are close, the mean over the channels that vary.

    A change of brightness or contrast of a channel leaves it as it is. NaN where no channel varies on both sides.
    """
    weight = close.double()
    total = close.sum(dim=1).double().clamp(min=1)

    def centered(values: Tensor) -> Tensor:
        mean = row_sums(values * weight) / total
        return (values - mean[..., None]).mul_(weight)

    a, b = centered(one), centered(other)
    products, left, right = (row_sums(x * y) / total for x, y in ((a, b), (a, a), (b, b)))  # (3, r)
    varies = (left > _LEAST_VARIANCE) & (right > _LEAST_VARIANCE)
    scale = torch.where(varies, left * right, torch.ones_like(left)).sqrt()
    correlation = torch.where(varies, products / scale, torch.full_like(scale, float("nan")))
    return correlation.t().contiguous().nanmean(dim=1)


def _thinned(values: Tensor) -> Tensor:
    """Every third number of rows (..., L), filled up with zeros."""
    thin = values[..., ::_STRIDE]
    return torch.nn.functional.pad(thin, (0, padded(thin.shape[-1]) - thin.shape[-1]))


def _over(values: Tensor, mask: Tensor) -> Tensor:
    """Sum (r,) float64 of (r, L) where the mask holds, in a fixed order."""
    return row_sums(torch.where(mask, values, 0.0).double())


def _mean(one: Tensor, other: Tensor) -> Tensor:
    """The mean of both directions, of those that say something."""
    both = torch.stack([one, other])
    return both.nanmean(dim=0)
