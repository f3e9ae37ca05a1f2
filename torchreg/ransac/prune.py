"""Samples that cannot be right, told from lengths alone before any solve.

A rigid motion keeps lengths. So a sample is dropped when an edge of its polygon in one cloud is shorter than
``edge_similarity`` times the same edge in the other (as Open3D's CorrespondenceCheckerBasedOnEdgeLength; the
paper: 0.9), and when it is degenerate: a point twice, or nearly on a line, which leaves the rotation open.
"""

from __future__ import annotations

from itertools import combinations

import torch
from torch import Tensor

_MIN_SINE = 0.05  # of the angle at the first point: about 3 degrees


def similar_edges(source: Tensor, target: Tensor, similarity: float) -> Tensor:
    """Which samples pass.

    Args:
        source: (3, S, R) coordinates of R samples of S points.
        target: (3, S, R).
        similarity: in [0, 1].

    Returns:
        (R,) bool.
    """
    limit = similarity * similarity
    passed = torch.ones(source.shape[-1], dtype=torch.bool, device=source.device)
    for i, j in combinations(range(source.shape[1]), 2):
        a, b = _square(source[:, i] - source[:, j]), _square(target[:, i] - target[:, j])
        passed &= (a >= limit * b) & (b >= limit * a) & (a > 0) & (b > 0)
    return passed


def spans_plane(points: Tensor) -> Tensor:
    """(R,) bool: the first three points of samples (3, S, R) are not nearly on a line."""
    u, v = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    normal = torch.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
    return _square(normal) > (_MIN_SINE * _MIN_SINE) * (_square(u) * _square(v))


def _square(vectors: Tensor) -> Tensor:
    x, y, z = vectors.unbind(0)
    return x * x + y * y + z * z
