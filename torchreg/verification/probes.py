"""Poses that would do as well if the scene were to blame: slid along what the surfaces leave open, or turned round.

A verdict that compares only what the solver found is blind to what it did not find. A plane, a corridor and a hall
like its mirror image admit other poses; these are tried on purpose.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.verification.information import Slide
from torchreg.verification.moments import Moments
from torchreg.verification.poses import Poses

SLIDE, FLIP = -1, -2
"""Origins of probes."""

_STEPS = (-16.0, -8.0, 8.0, 16.0)
"""Displacements along the weakest motion, in inlier thresholds: beyond what counts as the same pose."""


def slides(pose: Poses, weakest: Slide, threshold: Tensor) -> Poses:
    """One pose of each of G pairs displaced along its weakest motion, both ways: 4 each; thresholds (G,) in meters."""
    steps = torch.tensor(_STEPS, dtype=torch.float64, device=threshold.device)
    length = (steps * threshold[:, None])[..., None]  # (G, 4, 1)
    turn = _rotations(weakest.turn[:, None] * length)  # (G, 4, 3, 3)
    shift = weakest.shift[:, None] * length
    center = weakest.center[:, None]
    moved = apply_rotation(turn, pose.translation[:, None] - center) + center + shift
    return _probes(pose, _product(turn, pose.rotation[:, None]), moved, SLIDE)


def flips(pose: Poses, target: Moments) -> Poses:
    """One pose of each of G pairs after half turns about the three principal axes of the target's points."""
    _, axes = torch.linalg.eigh(target.products)  # columns
    axis = axes.transpose(1, 2)  # (G, 3, 3): axis by axis
    eye = torch.eye(3, dtype=axis.dtype, device=axis.device)
    turn = 2 * axis[..., :, None] * axis[..., None, :] - eye  # (G, 3, 3, 3)
    mean = target.mean[:, None]
    moved = apply_rotation(turn, pose.translation[:, None] - mean) + mean
    return _probes(pose, _product(turn, pose.rotation[:, None]), moved, FLIP)


def _probes(pose: Poses, rotation: Tensor, translation: Tensor, kind: int) -> Poses:
    """Probes (G, K, 3, 3), (G, K, 3) of G poses, pose by pose."""
    pair = pose.pair[:, None].expand(rotation.shape[:2]).flatten()
    return Poses(rotation.flatten(0, 1), translation.flatten(0, 1), torch.full_like(pair, kind), pair)


def _product(one: Tensor, other: Tensor) -> Tensor:
    """Matrix products (..., 3, 3), without a routine whose order of addition could depend on their number."""
    return (one[..., :, :, None] * other[..., None, :, :]).sum(dim=-2)


def _rotations(vectors: Tensor) -> Tensor:
    """The rotations (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    angle = vectors.square().sum(dim=-1).sqrt()
    x, y, z = (vectors / angle[..., None].clamp(min=1e-300)).unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    eye = torch.eye(3, dtype=vectors.dtype, device=vectors.device)
    # one by one, since a sine rounds differently at the end of a range
    single = angle.flatten().unbind(0)
    sine, cosine = (torch.stack([function(each) for each in single]) for function in (torch.sin, torch.cos))
    sine, cosine = (each.view(angle.shape)[..., None, None] for each in (sine, cosine))
    rotations: Tensor = eye + sine * cross + (1 - cosine) * _product(cross, cross)
    return rotations
