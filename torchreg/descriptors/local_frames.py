"""Local reference frames with repeatable signs, those of SHOT.

Tombari, Salti and Di Stefano, ECCV 2010, doi:10.1007/978-3-642-15558-1_26. For a point p with neighbors q_k, of which
d_k = q_k - p, within the radius R:

    M = sum_k (R - |d_k|) d_k d_k^T / sum_k (R - |d_k|)

z is the direction of least spread, the last eigenvector of M, x that of most, and y = z cross x. An eigenvector is an
axis without a sign: each of x and z is turned to where most neighbors lie (d_k . x >= 0). Where as many lie on both
sides, the five neighbors of middle distance decide. So a frame turns with its surface, with no viewpoint known.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torchreg.descriptors.descriptor import support_radius
from torchreg.descriptors.soft.arguments import expect_finite
from torchreg.errors import expect_floating
from torchreg.geometry.eigen import least_eigenvector, symmetric_eigen
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.derivatives import derivative_wanted
from torchreg.geometry.numerics.gather import gather
from torchreg.geometry.numerics.sums import NEIGHBOR_LANES, lane_sums
from torchreg.native import KERNEL_TYPES, call, native, rows
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.neighborhoods import expect_rows
from torchreg.types.precision import full_precision

LEAST_NEIGHBORS = 5
"""Apart from the point; with fewer there is no frame."""

_MIDDLE = 2  # neighbors on each side of the median that decide where the others are even


@full_precision
def local_frames(cloud: Clouds, near: Neighborhoods) -> Tensor:
    """The local reference frame of every point.

    Args:
        cloud: P points.
        near: the support of every point, with its radius, the point itself counted. Neighbors are weighed by how far
            they are from its border, so give enough slots that none of them is cut off.

    Returns:
        Frames (P, 3, 3) in the dtype of the points: the rows are the axes x, y and z, so ``frames @ (q - p)`` are the
        coordinates of a neighbor. They are zero where fewer than 5 neighbors lie apart from the point. As PCL's
        ``SHOTLocalReferenceFrameEstimation``, which has NaN there. Computed in float64; the same bits for any chunking,
        batch and number of threads, and in any order of points unless some are equally far.

        Gradients flow to the points, with the neighborhood and the signs held fixed: those of the eigenvectors, exact
        to second order, and of the weights. An axis that equal eigenvalues do not determine gets none.

    Raises:
        ValueError: neighborhoods without a radius, or shapes that do not fit.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(points=torch.rand(50, 3))
        >>> tr.local_frames(cloud, tr.neighbors(cloud, 0.5, 50)).shape
        torch.Size([50, 3, 3])
    """
    expect_rows(near, cloud)
    expect_floating(cloud.points, "points")
    expect_finite(cloud.points, "points")
    points = cloud.points
    radius = support_radius(near, points.new_empty(0, dtype=torch.float64))
    wanted = derivative_wanted(points)
    if native(points, near.index, near.valid) and points.dtype in KERNEL_TYPES and not wanted:
        return _frames_compiled(points, near, radius)
    columns = [column.contiguous() for column in points.unbind(1)]
    chunks = list(row_chunks(len(points), near.max_neighbors))
    if wanted and len(chunks) > 1:
        parts = [
            checkpoint(_frames, columns, near, radius, part, use_reentrant=False, preserve_rng_state=False)
            for part in chunks
        ]
    else:
        parts = [_frames(columns, near, radius, part) for part in chunks]
    return torch.cat(parts).to(points.dtype) if parts else points.new_zeros(0, 3, 3)


def _frames_compiled(points: Tensor, near: Neighborhoods, radius: Tensor) -> Tensor:
    """As ``_frames``, of all rows, in the dtype of the points."""
    out = points.new_empty(len(points), 3, 3)
    slots, sizes = (*rows(near.index), *rows(near.valid)), (len(points), near.max_neighbors)
    given = points.detach().contiguous(), radius[:, 0].detach().contiguous()
    call(f"local_frames_{KERNEL_TYPES[points.dtype]}", *given, *slots, *sizes, out)
    return out


def _frames(columns: list[Tensor], near: Neighborhoods, radius: Tensor, part: slice) -> Tensor:
    """Frames (r, 3, 3) float64 of some rows."""
    index, valid = near.index[part], near.valid[part]
    offset = [(gather(column, index) - column[part, None]).double() for column in columns]  # (r, K) each
    square = _dot(offset, offset)
    counted = valid & (square > 0)
    apart = torch.where(counted, square, 1.0)
    weight = (radius[part] - apart * apart.rsqrt()) * counted.double()
    covariance = _covariance(offset, weight)
    values, vectors = symmetric_eigen(covariance)
    least, most = vectors[..., 0], vectors[..., 2]  # (r, 3)
    if derivative_wanted(covariance):
        least = least_eigenvector(covariance, values, vectors)
        trace = values.sum(dim=-1)[..., None]
        rest = torch.eye(3, dtype=covariance.dtype, device=covariance.device) * trace[..., None] - covariance
        most = least_eigenvector(rest, trace - values.flip(-1), vectors.flip(-1))
    x = most * _sign(most.detach(), offset, counted)
    z = least * _sign(least.detach(), offset, counted)
    y = torch.stack([z[:, i] * x[:, j] - z[:, j] * x[:, i] for i, j in ((1, 2), (2, 0), (0, 1))], dim=1)
    enough = counted.sum(dim=1) >= LEAST_NEIGHBORS
    return torch.where(enough[:, None, None], torch.stack([x, y, z], dim=1), 0.0)


def _covariance(offset: list[Tensor], weight: Tensor) -> Tensor:
    """The sums (r, 3, 3) of weight (r, K) times offset times offset; their scale changes no eigenvector."""
    weighted = [weight * axis for axis in offset]
    entries = {(i, j): lane_sums(weighted[i] * offset[j], NEIGHBOR_LANES) for i in range(3) for j in range(i, 3)}
    lines = [torch.stack([entries[min(i, j), max(i, j)] for j in range(3)], dim=-1) for i in range(3)]
    return torch.stack(lines, dim=-2)


def _sign(axis: Tensor, offset: list[Tensor], counted: Tensor) -> Tensor:
    """1 or -1 (r, 1): where most of the counted neighbors lie along an axis (r, 3)."""
    along = _dot([axis[:, i, None] for i in range(3)], [each.detach() for each in offset])
    total = counted.sum(dim=1)
    ahead = 2 * ((along >= 0) & counted).sum(dim=1) - total
    rank = counted.cumsum(dim=1) - 1 - (total // 2)[:, None]
    middle = counted & (rank.abs() <= _MIDDLE)
    in_the_middle = ((along > 0) & middle).sum(dim=1)
    turned = (ahead < 0) | ((ahead == 0) & (in_the_middle <= _MIDDLE))
    return torch.where(turned, -1.0, 1.0).to(axis.dtype)[:, None]


def _dot(a: list[Tensor], b: list[Tensor]) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
