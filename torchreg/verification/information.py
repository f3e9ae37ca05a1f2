"""How firmly the overlapping surfaces hold a pose.

Two 6x6 matrices over the same points. Open3D's information matrix sums J^T J of point-to-point residuals, which
every pair of points holds in all directions. A scan slides along a plane or an axis all the same: there only the
residuals across the surface count, those of point-to-plane. The balance of that second matrix is the strength
(Gelfand et al., Geometrically stable sampling for the ICP algorithm, 3DIM 2003, doi:10.1109/IM.2003.1240258).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.chunks import stable_sum


class Slide(NamedTuple):
    """The motion that the surfaces resist least.

    Attributes:
        strength: in [0, 1]: square root of its share of the strongest motion's resistance.
        turn: (3,) float64, radians about ``center``; as a rotation vector.
        shift: (3,) float64, meters. Turn and shift together move the points by one meter (root mean square).
        center: (3,) float64, meters.
    """

    strength: float
    turn: Tensor
    shift: Tensor
    center: Tensor


def information_matrix(points: Tensor) -> Tensor:
    """Open3D's information matrix (6, 6) of the target points (K, 3) that have a partner, rotations first.

    As ``open3d.pipelines.registration.get_information_matrix_from_point_clouds``.
    """
    wide = points.double()
    first = stable_sum(wide)  # (3,)
    second = stable_sum((wide[:, :, None] * wide[:, None, :]).reshape(-1, 9)).reshape(3, 3)
    eye = torch.eye(3, dtype=torch.float64, device=points.device)
    turning = torch.trace(second) * eye - second  # sum of -[p]x [p]x
    crossed = _cross_matrix(first)
    return torch.cat([torch.cat([turning, crossed], 1), torch.cat([-crossed, len(points) * eye], 1)])


def strengths(points: Tensor, normals: Tensor, held: Tensor) -> Tensor:
    """The strength (H,) of H poses: points (H, N, 3) on surfaces with normals (H, N, 3), those that are ``held``."""
    return _strength(_hold(points, normals, held)[0], held)[0]


def slide(points: Tensor, normals: Tensor) -> Slide:
    """The weakest motion of points (K, 3) on surfaces with normals (K, 3); strength 0 for fewer than 6 points."""
    p = points.double()
    held = torch.ones_like(p[None, :, 0], dtype=torch.bool)
    matrix, center, size = _hold(p[None], normals[None], held)
    strength, weakest = _strength(matrix, held)
    turn, shift = weakest[0, :3] / size[0], weakest[0, 3:]
    moved = torch.linalg.cross(turn.expand_as(p), p - center[0]) + shift
    far = (stable_sum(moved.square().sum(dim=1)) / max(1, len(p))).sqrt().clamp(min=1e-12)
    return Slide(float(strength), turn / far, shift / far, center[0])


def _hold(points: Tensor, normals: Tensor, held: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Point-to-plane information (H, 6, 6), centers (H, 3) and sizes (H,), all over the points that are held."""
    weight = held.double()[..., None].transpose(0, 1)  # (N, H, 1)
    p, n = points.double().transpose(0, 1), normals.double().transpose(0, 1)  # (N, H, 3)
    total = stable_sum(weight).clamp(min=1)  # (H, 1)
    center = stable_sum(p * weight) / total
    apart = (p - center) * weight
    size = (stable_sum(apart.square().sum(dim=-1, keepdim=True)) / total).sqrt().clamp(min=1e-12)  # (H, 1)
    # turns are scaled by the size, so that one unit moves the rim by one meter as a unit of shift does
    rows = torch.cat([torch.linalg.cross(apart / size, n), n * weight], dim=-1)  # (N, H, 6)
    products = (rows[..., :, None] * rows[..., None, :]).flatten(-2)
    return stable_sum(products).unflatten(-1, (6, 6)), center, size[:, 0]


def _strength(matrix: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
    """Strengths (H,) and weakest motions (H, 6) of information matrices (H, 6, 6)."""
    values, vectors = torch.linalg.eigh(matrix)
    weakest = vectors[..., 0]
    largest = weakest.gather(1, weakest.abs().argmax(dim=1, keepdim=True))
    weakest = weakest * torch.where(largest < 0, -1.0, 1.0)  # one sign, whatever the routine
    enough = (held.sum(dim=1) >= 6) & (values[:, 5] > 0)
    top = torch.where(enough, values[:, 5], torch.ones_like(values[:, 5]))
    strength = torch.where(enough, (values[:, 0].clamp(min=0) / top).sqrt(), torch.zeros_like(top))
    return strength, torch.where(enough[:, None], weakest, torch.zeros_like(weakest))


def _cross_matrix(vector: Tensor) -> Tensor:
    """[v]x (3, 3), so that [v]x u = v x u."""
    x, y, z = vector.unbind()
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
