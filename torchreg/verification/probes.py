"""Poses that would do as well if the scene were to blame: slid along what the surfaces leave open, or turned round.

A verdict that compares only what the solver found is blind to what it did not find. A plane, a corridor and a hall
like its mirror image admit other poses; these are tried on purpose.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.chunks import stable_sum
from torchreg.geometry.se3 import apply_rotation
from torchreg.verification.information import Slide
from torchreg.verification.poses import Poses

SLIDE, FLIP = -1, -2
"""Origins of probes."""

_STEPS = (-16.0, -8.0, 8.0, 16.0)
"""Displacements along the weakest motion, in inlier thresholds: beyond what counts as the same pose."""


def slides(pose: Poses, weakest: Slide, threshold: float) -> Poses:
    """One pose (H = 1) displaced along its weakest motion, both ways."""
    rotations, translations = [], []
    for step in _STEPS:
        length = step * threshold
        turn = _rotation(weakest.turn * length)
        shift = weakest.shift * length
        rotations.append(_product(turn, pose.rotation[0]))
        moved = apply_rotation(turn, pose.translation[0] - weakest.center) + weakest.center + shift
        translations.append(moved)
    return _probes(rotations, translations, SLIDE)


def flips(pose: Poses, points: Tensor) -> Poses:
    """One pose (H = 1) after half turns about the three principal axes of the target's points (N, 3)."""
    wide = points.double()
    mean = stable_sum(wide) / len(wide)
    apart = wide - mean
    spread = stable_sum((apart[:, :, None] * apart[:, None, :]).reshape(-1, 9)).reshape(3, 3)
    _, axes = torch.linalg.eigh(spread)  # columns
    rotations, translations = [], []
    for i in range(3):
        axis = axes[:, i]
        turn = 2 * axis[:, None] * axis[None] - torch.eye(3, dtype=axis.dtype, device=axis.device)
        rotations.append(_product(turn, pose.rotation[0]))
        translations.append(apply_rotation(turn, pose.translation[0] - mean) + mean)
    return _probes(rotations, translations, FLIP)


def _probes(rotations: list[Tensor], translations: list[Tensor], kind: int) -> Poses:
    origin = torch.full((len(rotations),), kind, dtype=torch.int64, device=rotations[0].device)
    return Poses(torch.stack(rotations), torch.stack(translations), origin)


def _product(one: Tensor, other: Tensor) -> Tensor:
    return (one[:, :, None] * other[None]).sum(dim=1)


def _rotation(vector: Tensor) -> Tensor:
    """The rotation (3, 3) of a rotation vector (3,), by Rodrigues' formula."""
    angle = vector.square().sum().sqrt()
    x, y, z = (vector / angle.clamp(min=1e-300)).unbind()
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    eye = torch.eye(3, dtype=vector.dtype, device=vector.device)
    return eye + torch.sin(angle) * cross + (1 - torch.cos(angle)) * _product(cross, cross)
