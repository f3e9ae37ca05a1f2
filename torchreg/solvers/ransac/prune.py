"""Samples that cannot be right, told from lengths alone before any solve.

A rigid motion keeps lengths. So a sample is dropped when an edge of its polygon in one cloud is shorter than
``edge_similarity`` times the same edge in the other (as Open3D's CorrespondenceCheckerBasedOnEdgeLength; the
paper: 0.9), and when it is degenerate: a point twice, or nearly on a line, which leaves the rotation open. And a
transform that brings both ends of an edge within a threshold of their partners changes its length by no more than
twice the threshold; what changes more needs no solve to be known not to fit.
"""

from __future__ import annotations

import torch
from torch import Tensor

_MIN_SINE = 0.05  # of the angle at the first point: about 3 degrees
_ROUNDINGS = 1024  # far above the rounding of a length, of a solve and of a residual, in units of the coordinates
_WIDER = 1.02  # likewise, of the threshold

DISSIMILAR, SIMILAR, FITTING = 0, 1, 2
"""Marks of an edge: what fits is also similar."""


def edge_marks(source: Tensor, target: Tensor, similarity: float, slack: float) -> Tensor:
    """Judge edges.

    Args:
        source: (3, ...) differences of two points, meters.
        target: (3, ...) differences of their partners.
        similarity: in [0, 1], of the lengths of a similar edge.
        slack: meters, by which the lengths of a fitting edge differ at most.

    Returns:
        (...) uint8: ``DISSIMILAR``, ``SIMILAR`` or ``FITTING``.
    """
    limit = similarity * similarity
    a, b = _square(source), _square(target)
    similar = (a >= limit * b) & (b >= limit * a) & (a > 0) & (b > 0)
    apart = a.sqrt_().sub_(b.sqrt_()).abs_() > slack
    return similar.to(torch.uint8).mul_(FITTING - apart.to(torch.uint8))


def fitting_slack(source: Tensor, target: Tensor, threshold: float) -> float:
    """By how much lengths among points (3, M) and among their partners differ where both ends of an edge fit."""
    reach = float(torch.maximum(source.abs().amax(), target.abs().amax()))
    return 2 * _WIDER * threshold + _ROUNDINGS * reach * torch.finfo(source.dtype).eps


def spans_plane(points: Tensor) -> Tensor:
    """(...) bool: the first three points of samples (3, S, ...) are not nearly on a line."""
    u, v = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    normal = torch.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
    return _square(normal) > (_MIN_SINE * _MIN_SINE) * (_square(u) * _square(v))


def _square(vectors: Tensor) -> Tensor:
    x, y, z = vectors.unbind(0)
    return x * x + y * y + z * z
