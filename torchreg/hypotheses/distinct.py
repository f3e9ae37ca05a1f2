"""Poses that differ, chosen greedily from the best down.

Two poses differ by how far apart they put the matched source points, root mean square. With the points' mean c
and covariance S that is

    rms^2 = |dR c + dt|^2 + tr(dR S dR^T),   dR = R_1 - R_2, dt = t_1 - t_2

the squared distance of two vectors of 12 numbers, (R S^(1/2), R c + t): no point needs to be moved.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.chunks import stable_sum


def pose_vectors(rotation: Tensor, translation: Tensor, source: Tensor) -> Tensor:
    """(12, H) of poses (3, 3, H), (3, H): their distances are rms displacements of ``source`` (3, M), meters.

    Made by elementwise operations, so that a pose has its bits whatever stands beside it.
    """
    mean, root = _moments(source)
    mean, root = mean.to(rotation), root.to(rotation)
    columns = [*root.unbind(dim=1), mean]  # four directions (3,)
    rotated = [rotation[:, 0] * x + rotation[:, 1] * y + rotation[:, 2] * z for x, y, z in columns]  # (3, H) each
    rotated[3] = rotated[3] + translation
    return torch.cat(rotated)


def spread_out(vectors: Tensor, radius: float, count: int) -> Tensor:
    """Choose poses one by one, leaving out those nearer than ``radius`` to a chosen one.

    Args:
        vectors: (12, H), best first.
        radius: meters.
        count: how many at most.

    Returns:
        (K,) int64 places, ascending.
    """
    place = torch.arange(vectors.shape[1], device=vectors.device)
    chosen: list[Tensor] = []
    while len(place) > 0 and len(chosen) < count:
        chosen.append(place[:1])
        square = torch.zeros_like(vectors[0])
        for row in vectors:
            difference = row - row[0]
            square += difference * difference
        apart = square > radius * radius
        place, vectors = place[apart], vectors[:, apart]
    return torch.cat(chosen) if chosen else place


def _moments(source: Tensor) -> tuple[Tensor, Tensor]:
    """The mean (3,) and a root (3, 3) of the covariance of points (3, M)."""
    count = max(1, source.shape[1])
    mean = stable_sum(source.t()) / count
    moved = source - mean[:, None]
    products = (moved[:, None] * moved[None]).reshape(9, -1)
    values, vectors = torch.linalg.eigh((stable_sum(products.t()) / count).reshape(3, 3))
    return mean, vectors * values.clamp(min=0).sqrt()
