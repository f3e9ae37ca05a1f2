"""The rigid transform of a minimal sample in closed form, for many samples at once.

Three points lie in a plane, and the best rotation takes plane to plane: it aligns the normals of the two
triangles, and within the plane it is the two-dimensional least-squares rotation about the centroid. That is
the Kabsch solution, without a singular value decomposition. Larger samples go through ``kabsch``.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.kabsch import kabsch


def solve_samples(source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Rotations (3, 3, H) and translations (3, H) of samples (3, S, H); x_target = R x_source + t."""
    if source.shape[1] == 3:
        return _solve_triangles(source, target)
    T = kabsch(source.permute(2, 1, 0), target.permute(2, 1, 0))
    return T[:, :3, :3].permute(1, 2, 0), T[:, :3, 3].t()


def sample_fits(source: Tensor, target: Tensor, rotation: Tensor, translation: Tensor, threshold: float) -> Tensor:
    """(H,) bool: every point of the sample comes within the threshold of its partner."""
    worst = torch.zeros_like(translation[0])
    for s in range(source.shape[1]):
        square = torch.zeros_like(worst)
        for i in range(3):
            moved = rotation[i, 0] * source[0, s] + rotation[i, 1] * source[1, s] + rotation[i, 2] * source[2, s]
            difference = moved + translation[i] - target[i, s]
            square = square + difference * difference
        worst = torch.maximum(worst, square)
    return worst < threshold * threshold


def _solve_triangles(source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    center_s = (source[:, 0] + source[:, 1] + source[:, 2]) / 3
    center_t = (target[:, 0] + target[:, 1] + target[:, 2]) / 3
    u_s, w_s, n_s = _frame(source)
    u_t, w_t, n_t = _frame(target)
    cosine, sine = torch.zeros_like(center_s[0]), torch.zeros_like(center_s[0])
    for k in range(3):
        p, q = source[:, k] - center_s, target[:, k] - center_t
        pu, pw, qu, qw = _dot(p, u_s), _dot(p, w_s), _dot(q, u_t), _dot(q, w_t)
        cosine = cosine + (pu * qu + pw * qw)
        sine = sine + (pu * qw - pw * qu)
    length = (cosine * cosine + sine * sine).sqrt()
    safe = torch.where(length > 0, length, torch.ones_like(length))
    cosine, sine = torch.where(length > 0, cosine / safe, torch.ones_like(length)), sine / safe
    turned_u = cosine * u_t + sine * w_t
    turned_w = cosine * w_t - sine * u_t
    rotation = turned_u[:, None] * u_s[None] + turned_w[:, None] * w_s[None] + n_t[:, None] * n_s[None]  # (3, 3, H)
    moved = torch.stack([_dot(rotation[i], center_s) for i in range(3)])
    return rotation, center_t - moved


def _frame(points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Orthonormal axes (3, H) each: along the first edge, across it in the plane, and the normal."""
    u = _unit(points[:, 1] - points[:, 0])
    normal = _unit(_cross(u, points[:, 2] - points[:, 0]))
    return u, _cross(normal, u), normal


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return torch.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _unit(vectors: Tensor) -> Tensor:
    length = _dot(vectors, vectors).sqrt()
    return vectors / torch.where(length > 0, length, torch.ones_like(length))
