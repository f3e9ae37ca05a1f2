"""Poses that differ, chosen greedily from the best down.

Two poses differ by how far apart they put the matched source points, root mean square. With the points' mean c
and covariance S that is

    rms^2 = |dR c + dt|^2 + tr(dR S dR^T),   dR = R_1 - R_2, dt = t_1 - t_2

the squared distance of two vectors of 12 numbers, (R S^(1/2), R c + t): no point needs to be moved.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import row_sums
from torchreg.solvers.points import PairPoints, first_of_each


def pose_vectors(rotation: Tensor, translation: Tensor, source: Tensor) -> Tensor:
    """(12, H) of poses (3, 3, H), (3, H): their distances are rms displacements of ``source`` (3, M), meters.

    Made by elementwise operations, so that a pose has its bits whatever stands beside it.
    """
    mean, root = _moments(source[:, None], torch.ones_like(source[:1], dtype=torch.bool), [source.shape[1]])
    return _vectors(rotation, translation, mean.to(rotation), root.to(rotation))


def pose_vectors_of_pairs(rotation: Tensor, translation: Tensor, pair: Tensor, points: PairPoints) -> Tensor:
    """``pose_vectors`` of poses of the pairs ``pair`` (H,), each over its own pair's source points."""
    mean, root = _moments(points.source, points.valid, points.counts)
    return _vectors(rotation, translation, mean.to(rotation)[:, pair], root.to(rotation)[..., pair])


def spread_out(vectors: Tensor, radius: float, count: int) -> Tensor:
    """Choose poses one by one, leaving out those nearer than ``radius`` to a chosen one.

    Args:
        vectors: (12, H), best first.
        radius: meters.
        count: how many at most.

    Returns:
        (K,) int64 places, ascending.
    """
    one_pair = torch.zeros(vectors.shape[1], dtype=torch.int64, device=vectors.device)
    return spread_out_pairs(vectors, one_pair, [radius], count)


def spread_out_pairs(vectors: Tensor, pair: Tensor, radii: Sequence[float], count: int) -> Tensor:
    """``spread_out`` of the poses of each pair by themselves, all pairs in step.

    Args:
        vectors: (12, H), those of a pair together, best first.
        pair: (H,) int64, ascending.
        radii: meters, of each pair.
        count: how many at most of each pair.

    Returns:
        (K,) int64 places, ascending.
    """
    limits = torch.tensor([radius * radius for radius in radii], dtype=torch.float64).to(vectors)
    place = torch.arange(vectors.shape[1], device=vectors.device)
    chosen = [place[:0]]
    for _ in range(count):
        if len(place) == 0:
            break
        first = first_of_each(pair)
        chosen.append(place[first])
        difference = vectors - vectors[:, first][:, first.cumsum(dim=0) - 1]
        apart = (_square(difference) > limits[pair]).nonzero()[:, 0]
        place, pair, vectors = place[apart], pair[apart], vectors[:, apart]
    return torch.cat(chosen).sort().values


def _square(difference: Tensor) -> Tensor:
    """Squared lengths (H,) of vectors (12, H), which it overwrites; terms are added in their order."""
    difference.mul_(difference)
    total = difference[0]
    for row in difference[1:]:
        total += row
    return total


def _vectors(rotation: Tensor, translation: Tensor, mean: Tensor, root: Tensor) -> Tensor:
    """From means (3,) or (3, H) and roots of covariances (3, 3) or (3, 3, H)."""
    columns = [*root.unbind(dim=1), mean]  # four directions
    rotated = [rotation[:, 0] * x + rotation[:, 1] * y + rotation[:, 2] * z for x, y, z in columns]  # (3, H) each
    rotated[3] = rotated[3] + translation
    return torch.cat(rotated)


def _moments(source: Tensor, valid: Tensor, counts: Sequence[int]) -> tuple[Tensor, Tensor]:
    """The means (3, B) and roots (3, 3, B) of the covariances of points (3, B, M), where valid (B, M)."""
    count = torch.tensor([max(1, number) for number in counts], dtype=source.dtype, device=source.device)
    mean = row_sums(source) / count
    moved = torch.where(valid, source - mean[..., None], 0.0)
    products = row_sums((moved[:, None] * moved[None]).flatten(0, 1)) / count  # (9, B)
    values, vectors = torch.linalg.eigh(products.t().reshape(-1, 3, 3))
    root = vectors * values.clamp(min=0).sqrt()[:, None]
    return mean, root.permute(1, 2, 0)
