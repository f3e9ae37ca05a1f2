"""What the surfaces that lie on each other under one pose of every pair have to say about it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.verification.information import Slide, information_matrices, slides_of
from torchreg.verification.poses import Poses
from torchreg.verification.side import gathered, partners, rotated
from torchreg.verification.weigh import Scales


class Held(NamedTuple):
    """Target points that have a partner, of G pairs.

    Attributes:
        points: (3, G, L) float32, meters; those of each pair first, then zeros.
        normals: (3, G, L) float32, zeros where there are none.
        held: (G, L) bool, where a point stands.
    """

    points: Tensor
    normals: Tensor
    held: Tensor


def held(scales: Scales, poses: Poses) -> Held:
    """Under one pose of each pair."""
    source, target = scales.source, scales.target
    moved = rotated(poses.rotation, source.points.double()).add_(poses.translation.t()[..., None]).float()
    found = partners(target, poses.pair, moved, source.real)
    close = found.square < scales.threshold.square().float()[:, None]
    order = close.byte().sort(dim=1, descending=True, stable=True).indices  # those that are close come first
    close, row = close.gather(1, order), found.row.gather(1, order)
    points = gathered(target.all_points, row).masked_fill_(~close, 0.0)
    if target.all_normals is None:
        return Held(points, torch.zeros_like(points), close)
    return Held(points, gathered(target.all_normals, row).masked_fill_(~close, 0.0), close)


def slide(of: Held) -> Slide:
    """The weakest motions of G pairs."""
    return slides_of(of.points, of.normals, of.held)


def information(scales: Scales, of: Held) -> Tensor:
    """Information matrices (G, 6, 6) in the frames of the targets' files, for all points of the sources."""
    wide = of.points.double() + scales.target.origin.t()[..., None]
    sizes = torch.tensor(scales.source.points_of, device=wide.device) / scales.source.counts.clamp(min=1)
    return information_matrices(wide, of.held) * sizes[:, None, None]
