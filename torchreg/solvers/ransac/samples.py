"""Minimal samples: drawn the same for a pair in any batch, and their rigid transforms in closed form.

Three points lie in a plane, and the best rotation takes plane to plane: it aligns the normals of the two
triangles, and within the plane it is the two-dimensional least-squares rotation about the centroid. That is
the Kabsch solution, without a singular value decomposition. Larger samples go through ``kabsch``.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from torchreg.geometry.kabsch import kabsch
from torchreg.geometry.numerics.sums import lane_sums

FIRST_ROUND = 1 << 12
"""Hypotheses drawn at first, so that easy pairs stop soon; every round draws twice as many as the one before."""

LARGEST_ROUND = 1 << 15
"""Hypotheses drawn in a round at most; constants, since the stream of draws depends on them."""

_MIN_SINE = 0.05  # of the angle at the first point: about 3 degrees


def sample_rounds(count: int, size: int, total: int, seed: int, device: torch.device) -> Iterator[Tensor]:
    """Yield samples (R, size) int64 in [0, count), with replacement, until ``total`` are drawn."""
    generator = torch.Generator().manual_seed(seed)
    number, begin = FIRST_ROUND, 0
    while begin < total:
        drawn = torch.randint(count, (min(number, total - begin), size), generator=generator)
        yield drawn.to(device)
        begin, number = begin + number, min(2 * number, LARGEST_ROUND)


def solve_samples(source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Rotations (3, 3, H) and translations (3, H) of samples (3, S, H); x_target = R x_source + t."""
    if source.shape[1] == 3:
        return _solve_triangles(source, target)
    T = kabsch(source.permute(2, 1, 0), target.permute(2, 1, 0))
    return T[:, :3, :3].permute(1, 2, 0), T[:, :3, 3].t()


def spans_plane(points: Tensor) -> Tensor:
    """(...) bool: the first three points of samples (3, S, ...) are not nearly on a line."""
    u, v = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    normal = _cross(u, v)
    return _dot(normal, normal) > (_MIN_SINE * _MIN_SINE) * (_dot(u, u) * _dot(v, v))


def sample_fits(source: Tensor, target: Tensor, rotation: Tensor, translation: Tensor, threshold: float) -> Tensor:
    """(H,) bool: every point of the sample comes within the threshold of its partner."""
    square = torch.zeros_like(source[0])  # (S, H)
    for i in range(3):
        moved = rotation[i, 0] * source[0] + rotation[i, 1] * source[1] + rotation[i, 2] * source[2]
        difference = moved + translation[i] - target[i]
        square += difference * difference
    return square.amax(dim=0) < threshold * threshold


def _solve_triangles(source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    both = torch.stack([source, target], dim=2)  # (3, S, 2, H)
    center = (both[:, 0] + both[:, 1] + both[:, 2]) / 3  # (3, 2, H)
    u, w, n = _frame(both)
    apart = both - center[:, None]
    along, across = _dot(apart, u[:, None]), _dot(apart, w[:, None])  # (S, 2, H)
    (pu, qu), (pw, qw) = along.unbind(dim=1), across.unbind(dim=1)  # (S, H) each
    cosine, sine = lane_sums(pu * qu + pw * qw, 1, dim=0), lane_sums(pu * qw - pw * qu, 1, dim=0)
    length = (cosine * cosine + sine * sine).sqrt()
    safe = torch.where(length > 0, length, torch.ones_like(length))
    cosine, sine = torch.where(length > 0, cosine / safe, torch.ones_like(length)), sine / safe
    (u_s, u_t), (w_s, w_t), (n_s, n_t) = u.unbind(dim=1), w.unbind(dim=1), n.unbind(dim=1)  # (3, H) each
    turned_u = cosine * u_t + sine * w_t
    turned_w = cosine * w_t - sine * u_t
    rotation = turned_u[:, None] * u_s[None] + turned_w[:, None] * w_s[None] + n_t[:, None] * n_s[None]  # (3, 3, H)
    moved = _dot(rotation.transpose(0, 1), center[:, None, 0])
    return rotation, center[:, 1] - moved


def _frame(points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Orthonormal axes (3, ...) of points (3, S, ...): along the first edge, across it in the plane, the normal."""
    u = _unit(points[:, 1] - points[:, 0])
    normal = _unit(_cross(u, points[:, 2] - points[:, 0]))
    return u, _cross(normal, u), normal


def _dot(a: Tensor, b: Tensor) -> Tensor:
    """Over the first dimension, one term after another."""
    products = a * b
    return products[0] + products[1] + products[2]


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a.roll(-1, 0) * b.roll(-2, 0) - a.roll(-2, 0) * b.roll(-1, 0)


def _unit(vectors: Tensor) -> Tensor:
    length = _dot(vectors, vectors).sqrt()
    return vectors / torch.where(length > 0, length, torch.ones_like(length))
