"""How firmly the overlapping surfaces constrain a pose.

Two 6x6 matrices over the same points. Open3D's information matrix sums J^T J of point-to-point residuals, which
resist motion in all directions. Yet a scan slides along a plane or an axis: only the residuals across the surface
constrain it, those of point-to-plane. The balance of that second matrix is the strength
(Gelfand et al., Geometrically stable sampling for the ICP algorithm, 3DIM 2003, doi:10.1109/IM.2003.1240258).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import SAMPLE_LANES, lane_sums
from torchreg.native import KERNEL_TYPES, call, native

_LEAST = 6  # points that can hold a pose
_PRODUCTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # xx, yy, zz, xy, xz, yz


class WeakestMotion(NamedTuple):
    """The motions that the surfaces of G pairs resist least."""

    strength: Tensor  # (G,) float64 in [0, 1]: square root of its share of the strongest motion's resistance
    turn: Tensor  # (G, 3) float64, radians about ``center``; as rotation vectors
    shift: Tensor  # (G, 3) float64, meters. Turn and shift together move the points by one meter (root mean square)
    center: Tensor  # (G, 3) float64, meters


def information_matrices(points: Tensor, valid: Tensor) -> Tensor:
    """Open3D's information matrices (G, 6, 6) of the target points that have a partner, rotations first.

    As ``open3d.pipelines.registration.get_information_matrix_from_point_clouds``, of points (3, G, L) float64, meters,
    in the frame of the file, where ``valid`` (G, L).
    """
    wide = torch.where(valid, points, 0.0)
    x, y, z = lane_sums(wide).unbind(0)
    xx, yy, zz, xy, xz, yz = lane_sums(torch.stack([wide[i] * wide[j] for i, j in _PRODUCTS])).unbind(0)
    all_squares, zero, count = xx + yy + zz, torch.zeros_like(x), valid.sum(dim=1).double()
    rows = [  # the sum of -[p]x [p]x, [p]x and the identity
        [all_squares - xx, zero - xy, zero - xz, zero, -z, y],
        [zero - xy, all_squares - yy, zero - yz, z, zero, -x],
        [zero - xz, zero - yz, all_squares - zz, -y, x, zero],
        [-zero, z, -y, count, zero, zero],
        [-z, -zero, x, zero, count, zero],
        [y, -x, -zero, zero, zero, count],
    ]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def strengths(points: Tensor, normals: Tensor, valid: Tensor) -> Tensor:
    """The strength (R,) of R poses: points (3, R, L) on surfaces with normals (3, R, L), where ``valid`` (R, L)."""
    return _strength(_plane_information(points, normals, valid).matrix, valid)[0]


def weakest_motions(points: Tensor, normals: Tensor, valid: Tensor) -> WeakestMotion:
    """The weakest motions of points (3, G, L) on surfaces with normals (3, G, L), where ``valid`` (G, L).

    Strength 0 for fewer than 6 points.
    """
    p = points.double()
    planes = _plane_information(p, normals, valid)
    strength, weakest = _strength(planes.matrix, valid)
    turn, shift = weakest[:, :3] / planes.size[:, None], weakest[:, 3:]
    apart = p - planes.center[..., None]
    moved = torch.linalg.cross(turn.t()[..., None].expand_as(p), apart, dim=0) + shift.t()[..., None]
    x, y, z = torch.where(valid, moved, 0.0).square_().unbind(0)
    square = lane_sums(x.add_(y).add_(z)) / valid.sum(dim=1).clamp(min=1)
    far = square.sqrt().clamp(min=1e-12)[:, None]
    return WeakestMotion(strength, turn / far, shift / far, planes.center.t())


class _PlaneInformation(NamedTuple):
    """Point-to-plane information (R, 6, 6), centers (3, R) and sizes (R,), all over the valid points."""

    matrix: Tensor
    center: Tensor
    size: Tensor


def _plane_information(points: Tensor, normals: Tensor, valid: Tensor) -> _PlaneInformation:
    """Of points (3, R, L) with normals (3, R, L), where ``valid`` (R, L)."""
    products, center, square = _moment_sums(points, normals, valid)
    size = (square / valid.sum(dim=1).clamp(min=1)).sqrt().clamp(min=1e-12)
    matrix = torch.empty(len(valid), 6, 6, dtype=torch.float64, device=valid.device)
    i, j = torch.triu_indices(6, 6, device=valid.device)
    matrix[:, i, j] = matrix[:, j, i] = products.t()
    # turns are scaled by the size, so that one unit moves the rim by one meter as a unit of shift does
    unit = torch.cat([size[:, None].expand(-1, 3), torch.ones_like(center.t())], dim=1)  # (R, 6)
    return _PlaneInformation(matrix / (unit[:, :, None] * unit[:, None]), center, size)


def _moment_sums(points: Tensor, normals: Tensor, valid: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sums over the valid points of R poses.

    The upper triangles (21, R) of point-to-plane information, row by row, turns in radians about the centers; the
    centers (3, R); and the squared distances to these (R,).
    """
    if native(points, normals, valid) and points.dtype in KERNEL_TYPES and normals.dtype == torch.float32:
        return _moments_compiled(points, normals, valid)
    weight = valid.double()  # (R, L)
    p, n = points.double(), normals.double()  # (3, R, L)
    center = lane_sums(p * weight, SAMPLE_LANES) / valid.sum(dim=1).clamp(min=1)
    (x, y, z), (a, b, c) = (p - center[..., None]).mul_(weight).unbind(0), (n * weight).unbind(0)
    motions = torch.stack([y * c - z * b, z * a - x * c, x * b - y * a, a, b, c])  # (6, R, L)
    products = torch.empty(21, *weight.shape, dtype=motions.dtype, device=motions.device)
    begin = 0
    for i in range(6):
        torch.mul(motions[i:], motions[i], out=products[begin : begin + 6 - i])
        begin += 6 - i
    return lane_sums(products, SAMPLE_LANES), center, lane_sums(x * x + y * y + z * z, SAMPLE_LANES)


def _moments_compiled(points: Tensor, normals: Tensor, valid: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """As ``_moment_sums``."""
    rows = len(valid)
    products, center, square = (torch.empty(shape, dtype=torch.float64) for shape in ((21, rows), (3, rows), (rows,)))
    parts = (part.contiguous() for part in (points, normals, valid))
    call(f"moment_sums_{KERNEL_TYPES[points.dtype]}", *parts, products, center, square, *valid.shape)
    return products, center, square


def _strength(matrix: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Strengths (R,) and weakest motions (R, 6) of information matrices (R, 6, 6)."""
    values, vectors = torch.linalg.eigh(matrix)
    weakest = vectors[..., 0]
    largest = weakest.gather(1, weakest.abs().argmax(dim=1, keepdim=True))
    weakest = weakest * torch.where(largest < 0, -1.0, 1.0)  # one sign, whatever the routine
    enough = (valid.sum(dim=1) >= _LEAST) & (values[:, 5] > 0)
    top = torch.where(enough, values[:, 5], torch.ones_like(values[:, 5]))
    strength = torch.where(enough, (values[:, 0].clamp(min=0) / top).sqrt(), torch.zeros_like(top))
    return strength, torch.where(enough[:, None], weakest, torch.zeros_like(weakest))
