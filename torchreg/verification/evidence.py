"""Evidence of the clouds themselves for a pose, beyond the matches that it was estimated from.

In both directions: which points of one scan have a partner in the other (overlap), whether the surfaces
face the same way there (normals), whether their colors go together up to brightness and contrast of every channel
(colors), and whether one scan stands where the other scanner saw free space (conflict).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather, gather_columns
from torchreg.geometry.numerics.sums import padded_row_sums
from torchreg.verification.candidates import joined
from torchreg.verification.free_space import RangeImages, visibility
from torchreg.verification.information import strengths
from torchreg.verification.model import Evidence
from torchreg.verification.partners import can_be_near, partners
from torchreg.verification.scans import Scans, rotated, thinned

_LEAST_VARIANCE = 1e-5  # of a channel in [0, 1]: below it, the channel is one gray value and its rounding
_ELEMENTS = 1 << 15  # points moved at once: what is made of them stays in the cache


class Overlap(NamedTuple):
    """Target points that have a partner, of G pairs."""

    points: Tensor  # (3, G, L) float32, meters; those of each pair first, then zeros
    normals: Tensor  # (3, G, L) float32, zeros where there are none
    valid: Tensor  # (G, L) bool, where a point stands


def evidence(
    source: Scans, target: Scans, pair: Tensor, rotation: Tensor, translation: Tensor, threshold: Tensor
) -> Evidence:
    """Weigh poses of G pairs together; the evidence for a pose does not depend on the others.

    Poses are as in ``candidates.Poses``; ``threshold`` (G,) float64, meters, is that of an inlier.
    """
    back = rotation.transpose(-1, -2)
    home = -(back * translation[:, None, :]).sum(dim=-1)
    forth = _one_way(source, target, pair, rotation, translation, threshold)
    return Evidence(*map(_mean, forth, _one_way(target, source, pair, back, home, threshold)))


def overlap(source: Scans, target: Scans, rotation: Tensor, translation: Tensor, threshold: Tensor) -> Overlap:
    """The target points that the source's lie on, under one pose (G, 3, 3), (G, 3) of each pair; as ``evidence``."""
    moved = rotated(rotation, source.points.double()).add_(translation.t()[..., None]).float()
    nearest = partners(target.search, torch.arange(len(rotation), device=rotation.device), moved, source.valid)
    close = nearest.square < threshold.square().float()[:, None]
    order = close.byte().sort(dim=1, descending=True, stable=True).indices  # those that are close come first
    close, row = close.gather(1, order), nearest.row.gather(1, order)
    points = gather_columns(target.all_points, row).masked_fill_(~close, 0.0)
    if target.all_normals is None:
        return Overlap(points, torch.zeros_like(points), close)
    return Overlap(points, gather_columns(target.all_normals, row).masked_fill_(~close, 0.0), close)


def _one_way(
    source: Scans, target: Scans, pair: Tensor, rotation: Tensor, translation: Tensor, threshold: Tensor
) -> Evidence:
    parts = [
        _of_poses(source, target, pair[rows], rotation[rows].float(), translation[rows].float(), threshold)
        for rows in row_chunks(len(pair), source.valid.shape[1], _ELEMENTS)
    ]
    return joined(parts)


def _of_poses(source: Scans, target: Scans, pair: Tensor, R: Tensor, t: Tensor, threshold: Tensor) -> Evidence:
    """As ``_one_way``, of a few poses (r, 3, 3), (r, 3), float32."""
    limit = threshold[pair]  # (r,)
    square_limit = limit.square().float()[:, None]
    moved = rotated(R, source.points[:, pair]).add_(t.t()[..., None])  # (3, r, L)
    valid = source.valid[pair]
    nearest = partners(target.search, pair, moved, valid)
    close = nearest.square < square_limit  # (r, L)
    count = close.sum(dim=1).double()
    nothing = torch.full_like(count, float("nan"))
    some = count.clamp(min=1)
    closeness = _over(1 - nearest.square / square_limit, close) / some
    normals, colors, conflict, strength = nothing, nothing, nothing, torch.zeros_like(count)
    if source.normals is not None and target.all_normals is not None:
        facing = gather_columns(target.all_normals, nearest.row)
        x, y, z = rotated(R, source.normals[:, pair]).mul_(facing).unbind(0)
        cosine = x.add_(y).add_(z)
        known = source.faced[pair] & gather(target.all_faced, nearest.row)
        cosine = torch.where(known, cosine, cosine.abs())  # which side a surface faces may not be known
        normals = torch.where(count > 0, _over(cosine, close) / some, nothing)
        strength = strengths(*(thinned(values) for values in (moved, facing, close)))
    if source.colors is not None and target.all_colors is not None:
        colors = _correlation(source.colors[:, pair], gather_columns(target.all_colors, nearest.row), close)
    if target.images is not None:
        conflict = _conflict(target.images, target.image[pair], moved, valid, limit)
    around = (can_be_near(target.search.around, pair, moved) & valid).sum(dim=1).double()
    misses = (around - count) / around.clamp(min=1)
    few, close_few = thinned(nearest.row), thinned(close)
    features = [
        nothing if one is None or other is None else _concordance(one[:, pair], gather_columns(other, few), close_few)
        for one, other in zip(source.features, target.all_features, strict=True)
    ]
    return Evidence(
        count / source.counts[pair].clamp(min=1), closeness, normals, colors, strength, conflict, misses, *features
    )


def _concordance(one: Tensor, other: Tensor, close: Tensor) -> Tensor:
    """Agreement (r,) of the features (D, r, L') of partners, as the concordance correlation of numbers (Lin, 1989).

    1 less the mean squared difference of partners over that of each with the partners of all others: 1 where partners
    have the same features, about 0 where any two points of the overlap are as much alike. 0 for fewer than 6 partners.
    """
    weight = close.double()
    total = close.sum(dim=1).double()
    count = total.clamp(min=1)

    def mean(values: Tensor) -> Tensor:
        return padded_row_sums(values.double() * weight) / count

    difference = one - other
    apart = mean((difference * difference).double().cumsum(dim=0)[-1])
    square = mean((one * one + other * other).double().cumsum(dim=0)[-1])
    middle = (mean(one) * mean(other)).cumsum(dim=0)[-1]
    strangers = square - 2 * middle  # of each with the partners of all others, squared
    return torch.where((total >= 6) & (strangers > 1e-12), 1 - apart / strangers.clamp(min=1e-12), 0.0)


def _conflict(images: RangeImages, which: Tensor, moved: Tensor, valid: Tensor, limit: Tensor) -> Tensor:
    """Share (r,) of the points moved (3, r, L) that stand in free space; NaN without an image, ``which`` is -1."""
    seen = visibility(images, which.clamp(min=0), moved, 2 * limit)
    valid = valid & (which >= 0)[:, None]
    before, on = (seen.before & valid).sum(dim=1).double(), (seen.on & valid).sum(dim=1).double()
    return torch.where(before + on > 0, before / (before + on).clamp(min=1), float("nan"))


def _correlation(one: Tensor, other: Tensor, close: Tensor) -> Tensor:
    """Correlation (r,) of colors (3, r, L) over the points that are close, the mean over the channels that vary.

    A change of brightness or contrast of a channel leaves it as it is. NaN where no channel varies on both sides.
    """
    weight = close.double()
    total = close.sum(dim=1).double().clamp(min=1)

    def centered(values: Tensor) -> Tensor:
        mean = padded_row_sums(values * weight) / total
        return (values - mean[..., None]).mul_(weight)

    a, b = centered(one), centered(other)
    products, left, right = (padded_row_sums(x * y) / total for x, y in ((a, b), (a, a), (b, b)))  # (3, r)
    varies = (left > _LEAST_VARIANCE) & (right > _LEAST_VARIANCE)
    scale = torch.where(varies, left * right, torch.ones_like(left)).sqrt()
    correlation = torch.where(varies, products / scale, torch.full_like(scale, float("nan")))
    return correlation.t().contiguous().nanmean(dim=1)


def _over(values: Tensor, mask: Tensor) -> Tensor:
    """Sum (r,) float64 of (r, L) where the mask holds, in a fixed order."""
    return padded_row_sums(torch.where(mask, values, 0.0).double())


def _mean(one: Tensor, other: Tensor) -> Tensor:
    """The mean of both directions, without those that are NaN."""
    return torch.stack([one, other]).nanmean(dim=0)
