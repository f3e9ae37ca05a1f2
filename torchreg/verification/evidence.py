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
from torchreg.geometry.numerics.gather import gather_columns
from torchreg.verification.candidates import joined
from torchreg.verification.concordance import concordance
from torchreg.verification.free_space import visible_counts
from torchreg.verification.information import strengths
from torchreg.verification.model import Evidence
from torchreg.verification.partner_terms import partner_terms
from torchreg.verification.partners import near_counts, partners
from torchreg.verification.scans import Scans, moved_points, rotated, thinned

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
    square_limit, every = threshold.square().float(), torch.arange(len(rotation), device=rotation.device)
    nearest = partners(target.search, every, moved, source.valid, square_limit)
    close = nearest.square < square_limit[:, None]
    order = close.byte().sort(dim=1, descending=True, stable=True).indices  # those that are close come first
    close, row = close.gather(1, order), nearest.row.gather(1, order)
    points = gather_columns(target.all_points, row).masked_fill_(~close, 0.0)
    if target.all_normals is None:
        return Overlap(points, torch.zeros_like(points), close)
    return Overlap(points, gather_columns(target.all_normals, row).masked_fill_(~close, 0.0), close)


def _one_way(
    source: Scans, target: Scans, pair: Tensor, rotation: Tensor, translation: Tensor, threshold: Tensor
) -> Evidence:
    rotation, translation = rotation.float().contiguous(), translation.float().contiguous()
    parts = [
        _of_poses(source, target, pair[rows], rotation[rows], translation[rows], threshold)
        for rows in row_chunks(len(pair), source.valid.shape[1], _ELEMENTS)
    ]
    return joined(parts)


def _of_poses(source: Scans, target: Scans, pair: Tensor, R: Tensor, t: Tensor, threshold: Tensor) -> Evidence:
    """As ``_one_way``, of a few poses (r, 3, 3), (r, 3), float32."""
    limit = threshold[pair]  # (r,)
    square_limit = limit.square().float()
    moved = moved_points(source, pair, R, t)  # (3, r, L)
    valid = source.valid[pair]
    found = partners(target.search, pair, moved, valid, square_limit)
    terms = partner_terms(source, target, pair, R, found, square_limit)
    count = terms.partners
    nothing = torch.full_like(count, float("nan"))
    conflict, strength = nothing, torch.zeros_like(count)
    if source.normals is not None and target.all_normals is not None:
        facing = gather_columns(target.all_normals, thinned(found.row))
        strength = strengths(thinned(moved), facing, thinned(found.square < square_limit[:, None]))
    if target.images is not None:
        conflict = _conflict(visible_counts(target.images, target.image[pair], moved, valid, 2 * limit))
    around = near_counts(target.around, pair, moved, valid).double()
    misses = (around - count) / around.clamp(min=1)
    features = [
        nothing if one is None or other is None else concordance(one, other, pair, found, square_limit)
        for one, other in zip(source.features, target.all_features, strict=True)
    ]
    overlapping = count / source.counts[pair].clamp(min=1)
    return Evidence(overlapping, terms.closeness, terms.normals, terms.colors, strength, conflict, misses, *features)


def _conflict(counts: Tensor) -> Tensor:
    """Share (r,) of the points that stand in free space, from ``visible_counts``; NaN where none is counted."""
    before, on = counts.double()
    return torch.where(before + on > 0, before / (before + on).clamp(min=1), float("nan"))


def _mean(one: Tensor, other: Tensor) -> Tensor:
    """The mean of both directions, without those that are NaN."""
    return torch.stack([one, other]).nanmean(dim=0)
