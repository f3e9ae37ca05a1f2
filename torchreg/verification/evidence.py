"""What the clouds themselves say of a pose, beyond the matches it was found from.

Looked at from both sides: which points of one scan have a partner in the other (overlap), whether the surfaces
face the same way there (normals), whether their colors go together up to brightness and contrast of every channel
(colors), and whether one scan stands where the other scanner saw free space (conflict).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.chunks import stable_sum
from torchreg.geometry.se3 import apply_rotation
from torchreg.verification.free_space import sight
from torchreg.verification.information import strengths
from torchreg.verification.view import View

_LEAST_VARIANCE = 1e-5  # of a channel in [0, 1]: below it, the channel is one gray value and its rounding

_STRIDE = 3  # of the points that tell the strength


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

    def take(self, index: Tensor) -> Evidence:
        """The poses ``index`` (K,), in that order."""
        return Evidence(*(value[index] for value in self))


def evidence(source: View, target: View, rotation: Tensor, translation: Tensor, threshold: float) -> Evidence:
    """Weigh poses (H, 3, 3), (H, 3): x_target = R x_source + t in the frames of ``points``, meters."""
    forth = _one_way(source, target, rotation, translation, threshold)
    back = rotation.transpose(-1, -2)
    home = -(back * translation[:, None, :]).sum(dim=-1)
    return Evidence(*map(_mean, forth, _one_way(target, source, back, home, threshold)))


def _one_way(source: View, target: View, rotation: Tensor, translation: Tensor, threshold: float) -> Evidence:
    R, t = rotation.float(), translation.float()
    moved = apply_rotation(R[:, None], source.points[source.sample]) + t[:, None]  # (H, N, 3)
    found = target.tree.nearest(moved.reshape(-1, 3))
    square = found.sq_distance.reshape(moved.shape[:2])  # (H, N)
    partner = found.index.reshape(moved.shape[:2])
    close = square < threshold * threshold
    count = close.sum(dim=1).double()
    nothing = torch.full_like(count, float("nan"))
    share = count / max(1, moved.shape[1])
    closeness = _over(1 - square / (threshold * threshold), close) / count.clamp(min=1)
    normals, colors, conflict = nothing, nothing, nothing
    strength = torch.zeros_like(count)
    if source.normals is not None and target.normals is not None:
        turned = apply_rotation(R[:, None], source.normals[source.sample])
        cosine = (turned * target.normals[partner]).sum(dim=-1)
        if not (source.faced and target.faced):
            cosine = cosine.abs()  # which side a surface faces is not known
        some = slice(None, None, _STRIDE)
        strength = strengths(moved[:, some], target.normals[partner[:, some]], close[:, some])
        normals = torch.where(count > 0, _over(cosine, close) / count.clamp(min=1), nothing)
    if source.colors is not None and target.colors is not None:
        colors = _correlation(source.colors[source.sample].expand_as(moved), target.colors[partner], close)
    if target.image is not None:
        seen = sight(target.image, moved, 2 * threshold)
        before, on = seen.before.sum(dim=1).double(), seen.on.sum(dim=1).double()
        conflict = torch.where(before + on > 0, before / (before + on).clamp(min=1), nothing)
    return Evidence(share, closeness, normals, colors, strength, conflict)


def _correlation(one: Tensor, other: Tensor, close: Tensor) -> Tensor:
    """Correlation (H,) of colors (H, N, 3) over the rows that are close, the mean over the channels that vary.

    A change of brightness or contrast of a channel leaves it as it is. NaN where no channel varies on both sides.
    """
    weight = close[..., None].double()
    total = stable_sum(weight.transpose(0, 1)).clamp(min=1)  # (H, 1)

    def centered(values: Tensor) -> Tensor:
        mean = stable_sum((values * weight).transpose(0, 1)) / total
        return (values - mean[:, None]) * weight

    a, b = centered(one.double()), centered(other.double())
    products, left, right = (stable_sum((x * y).transpose(0, 1)) / total for x, y in ((a, b), (a, a), (b, b)))
    varies = (left > _LEAST_VARIANCE) & (right > _LEAST_VARIANCE)  # (H, 3)
    scale = torch.where(varies, left * right, torch.ones_like(left)).sqrt()
    return torch.where(varies, products / scale, torch.full_like(scale, float("nan"))).nanmean(dim=1)


def _over(values: Tensor, mask: Tensor) -> Tensor:
    """Sum (H,) float64 of (H, N) where the mask holds, in a fixed order."""
    return stable_sum(torch.where(mask, values, torch.zeros_like(values)).double().t())


def _mean(one: Tensor, other: Tensor) -> Tensor:
    """The mean of both directions, of those that say something."""
    both = torch.stack([one, other])
    return both.nanmean(dim=0)
