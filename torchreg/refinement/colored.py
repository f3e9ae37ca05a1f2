"""Colored ICP (Park, Zhou and Koltun, ICCV 2017, doi:10.1109/ICCV.2017.25), in the form Open3D gives it.

Beside the distance to the plane, r_G = sqrt(1 - c) (p - q) . n, stands the difference of intensity, r_C = sqrt(c)
(I_p - I_q - d . (p' - q)), where p' is p on the plane of q, d the gradient of intensity on that plane and c the
color weight. Intensity is the mean of red, green and blue.

The gradient of intensity at a point minimizes sum_k (d . (p_k - p) - (I_k - I))^2 + ((K-1) n . d)^2 over d (section
4.1). The paper puts the neighbors on the plane first; Open3D 0.20 gives what the sum above does (measured: to 1e-14),
where only the last term draws d into the plane.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.neighborhoods import neighbors
from torchreg.refinement.blocks import dot
from torchreg.refinement.estimator import Estimator, IcpKind, MatchedBlocks
from torchreg.refinement.gauss_newton import CHANNELS, products, solve
from torchreg.refinement.kernels import Kernel
from torchreg.refinement.point_to_plane import jacobian, plane_residual, planes
from torchreg.types import Clouds, Neighborhoods

MAX_NEIGHBORS = 30
LEAST_NEIGHBORS = 4  # with fewer, the point itself counted, there is no gradient
_RANK = 1e-10  # of the determinant to the squared trace: below it the neighbors lie on a line


def colored(kernel: Kernel) -> Estimator:
    """Gauss-Newton on both residuals; partners are (x, y, z, normal, gradient, intensity), ``extra`` is intensity.

    The kernel weighs each of the two by itself, with one scale, as Open3D does.
    """

    def terms(matched: MatchedBlocks) -> Tensor:
        q, n, d, intensity = matched.partner.split([3, 3, 3, 1])
        distance, slope = plane_residual(matched), dot(d, n)
        share, rest = matched.color_weight.sqrt(), (1 - matched.color_weight).sqrt()  # (k, 1)
        geometric = rest * distance
        weight = matched.inside * kernel(geometric, matched.kernel_scale)
        out = products(jacobian(matched.moved, rest * n, geometric), weight)
        on_plane = dot(d, matched.moved - q) - distance * slope  # d . (p' - q)
        photometric = share * (matched.extra[0] - intensity[0] - on_plane)
        flat = (n * slope).sub_(d).mul_(share)  # -d on the plane
        weight = matched.inside * kernel(photometric, matched.kernel_scale)
        return products(jacobian(matched.moved, flat, photometric), weight, onto=out)

    return Estimator(CHANNELS, terms, solve)


def _columns(source: Clouds, target: Clouds, max_distance: Tensor) -> tuple[Tensor, Tensor]:
    columns, intensity = planes(target), intensity_of(target)
    gradient = color_gradient(target, columns[:, 3:], intensity, 2 * max_distance.cpu())
    return torch.cat([columns, gradient, intensity[:, None]], dim=1), intensity_of(source)[:, None]


def intensity_of(cloud: Clouds) -> Tensor:
    """The mean (P,) of red, green and blue, float64."""
    if cloud.colors is None:
        raise ValueError("cloud: expected colors, got none")
    red, green, blue = cloud.colors.double().unbind(1)
    return (red + green + blue) / 3


def color_gradient(cloud: Clouds, normals: Tensor, intensity: Tensor, radius: Tensor) -> Tensor:
    """The gradients (P, 3) float64 of intensity, per meter, on the tangent plane of every point of B clouds.

    Normals (P, 3) and intensity (P,) are float64; neighbors are the 30 nearest within ``radius`` (B,) meters, as in
    Open3D. Zeros where a point has fewer than 4 neighbors (itself counted) or all on one line with it.
    """
    near = neighbors(cloud, radius, MAX_NEIGHBORS)
    points = cloud.points.t().contiguous()  # (3, P)
    first, second = tangents(normals.t().contiguous())
    out = torch.empty_like(points)
    for rows in row_chunks(len(cloud.points), MAX_NEIGHBORS):
        out[:, rows] = _least_squares(points, first, second, intensity, near, rows)
    return out.t()


def tangents(normals: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors (3, P) each that make a right-handed basis with unit normals (3, P).

    Duff et al., Building an orthonormal basis, revisited, JCGT 6(1), 2017.
    """
    x, y, z = normals.unbind(0)
    sign = torch.copysign(torch.ones_like(z), z)
    a = -1 / (sign + z)
    b = x * y * a
    return torch.stack([1 + sign * x * x * a, sign * b, -sign * x]), torch.stack([b, sign + y * y * a, -y])


def _least_squares(
    points: Tensor, first: Tensor, second: Tensor, value: Tensor, near: Neighborhoods, rows: slice
) -> Tensor:
    """Gradients (3, r) of some rows."""
    index, valid = near.index[rows], near.valid[rows]  # (r, 30)
    weight = valid.double()
    x, y, z = ((axis[index] - axis[rows, None]).mul_(weight) for axis in points.unbind(0))
    normal = torch.linalg.cross(first[:, rows], second[:, rows], dim=0)
    u, v, w = (x * axis[0, :, None] + y * axis[1, :, None] + z * axis[2, :, None]
               for axis in (first[:, rows], second[:, rows], normal))  # fmt: skip
    change = value[index] - value[rows, None]
    uu, uv, vv, uw, vw, ww = ((a * b).sum(dim=1) for a, b in ((u, u), (u, v), (v, v), (u, w), (v, w), (w, w)))
    ub, vb, wb = ((a * change).sum(dim=1) for a in (u, v, w))
    count = valid.sum(dim=1)
    stiff = ww + (count - 1).clamp_min(1).double().square()  # eliminated first: it is the largest
    uu, uv, vv = uu - uw * uw / stiff, uv - uw * vw / stiff, vv - vw * vw / stiff
    ub, vb = ub - uw * wb / stiff, vb - vw * wb / stiff
    determinant, trace = uu * vv - uv * uv, uu + vv
    solvable = (count >= LEAST_NEIGHBORS) & (determinant > _RANK * trace * trace)
    safe, zero = torch.where(solvable, determinant, 1.0), torch.zeros_like(determinant)
    along_u = torch.where(solvable, (vv * ub - uv * vb) / safe, zero)
    along_v = torch.where(solvable, (uu * vb - uv * ub) / safe, zero)
    along_w = torch.where(solvable, (wb - uw * along_u - vw * along_v) / stiff, zero)
    gradient: Tensor = along_u * first[:, rows] + along_v * second[:, rows] + along_w * normal
    return gradient


COLORED = IcpKind(
    needs=(("target", "normals"), ("source", "colors"), ("target", "colors")), columns=_columns, estimator=colored
)
