"""Poses of one pair on their way through the verification."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import rigid
from torchreg.hypotheses.distinct import pose_vectors, spread_out


class Poses(NamedTuple):
    """H poses of one pair, between the frames of ``points`` (origins left out).

    Attributes:
        rotation: (H, 3, 3) float64.
        translation: (H, 3) float64, meters.
        origin: (H,) int64, which proposal each came from; probes have negative numbers.
    """

    rotation: Tensor
    translation: Tensor
    origin: Tensor

    def take(self, rows: Tensor | slice) -> Poses:
        """The poses ``rows`` (K,), in that order."""
        return Poses(self.rotation[rows], self.translation[rows], self.origin[rows])

    def matrices(self) -> Tensor:
        """(H, 4, 4)."""
        return rigid(self.rotation, self.translation)

    def moved(self, T: Tensor) -> Poses:
        """The same with other transforms (H, 4, 4)."""
        return Poses(T[:, :3, :3], T[:, :3, 3], self.origin)

    def vectors(self, points: Tensor) -> Tensor:
        """(12, H), whose distances are rms displacements of ``points`` (N, 3), meters."""
        return pose_vectors(self.rotation.permute(1, 2, 0), self.translation.t(), points.double().t())


def joined(parts: list[Poses]) -> Poses:
    """All poses of the parts, in order."""
    return Poses(*(torch.cat(values) for values in zip(*parts, strict=True)))


def distinct(poses: Poses, points: Tensor, apart: float) -> Tensor:
    """Rows (K,) of the poses that move ``points`` (N, 3) more than ``apart`` meters away from all kept before."""
    return spread_out(poses.vectors(points), apart, len(poses.origin))
