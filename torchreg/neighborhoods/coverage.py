"""How much of one point set another covers under a transform, as Open3D's ``evaluate_registration``."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import lane_sums
from torchreg.geometry.se3 import apply_rotation
from torchreg.neighborhoods.point_index import nearest


class Coverage(NamedTuple):
    """Coverage of one source by one target."""

    fitness: Tensor  # scalar float64, share of source points with a target point nearer than the threshold
    inlier_rmse: Tensor  # scalar float64, meters, root mean square of those distances; 0 where there are none


def coverage(source: Tensor, target: Tensor, rotation: Tensor, translation: Tensor, threshold: float) -> Coverage:
    """Coverage of ``source`` (P, 3) by ``target`` (Q, 3), both in meters and in frames without origins.

    ``rotation`` (3, 3) and ``translation`` (3,) are float64; distances are strictly below ``threshold``, meters.
    """
    zero = torch.zeros((), dtype=torch.float64, device=source.device)
    if len(source) == 0 or len(target) == 0:
        return Coverage(zero, zero)
    moved = apply_rotation(rotation, source.double()) + translation
    square = nearest(moved, target.double()).sq_distance
    inside = square < threshold * threshold
    count = inside.sum()
    total = lane_sums(torch.where(inside, square, torch.zeros_like(square)), dim=0)
    return Coverage(count.double() / len(moved), (total / count.clamp(min=1)).sqrt())
