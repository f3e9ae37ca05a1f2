"""Frames of small numbers: every cloud about its own mean point, its origin taken out.

A transform between files, x_t = R x_s + t, becomes R, t' between these frames and comes back without the loss
that coordinates of UTM size would bring to sums of products.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import stable_sum
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.refinement.pairing import Pairing
from torchreg.types import Clouds
from torchreg.types.packing import spans


class Frames(NamedTuple):
    """Where the zeros of both frames of every pair lie, (B, 3) float64, meters.

    Attributes:
        source_center: relative to the source's origin: the mean of its points.
        target_center: likewise.
        source_origin: of the clouds.
        target_origin: of the clouds.
    """

    source_center: Tensor
    target_center: Tensor
    source_origin: Tensor
    target_origin: Tensor


def centered_frames(source: Clouds, target: Clouds, pairing: Pairing) -> Frames:
    """The frames of B pairs of finite, not empty clouds."""
    one, other = list(pairing.source), list(pairing.target)
    return Frames(_means(source)[one], _means(target)[other], source.origin[one], target.origin[other])


def enter(frames: Frames, T_target_source: Tensor) -> tuple[Tensor, Tensor]:
    """R (B, 3, 3) and t (B, 3) between the centered frames, from transforms (B, 4, 4) between those of the files."""
    R = T_target_source[:, :3, :3]
    between = T_target_source[:, :3, 3] + apply_rotation(R, frames.source_origin) - frames.target_origin
    return R, between + apply_rotation(R, frames.source_center) - frames.target_center


def leave(frames: Frames, rotation: Tensor, translation: Tensor) -> Tensor:
    """Back from the centered frames to T_target_source (B, 4, 4) between those of the files."""
    between = translation - apply_rotation(rotation, frames.source_center) + frames.target_center
    return rigid(rotation, between - apply_rotation(rotation, frames.source_origin) + frames.target_origin)


def _means(clouds: Clouds) -> Tensor:
    means = [stable_sum(clouds.points[i:j].double()) / max(1, j - i) for i, j in spans(clouds.offsets)]
    return torch.stack(means) if means else clouds.origin
