"""Surface normals by principal components, turned to the scanner.

The normal of a point is the direction in which its neighborhood spreads least (Hoppe et al., SIGGRAPH 1992,
doi:10.1145/133994.134011). That leaves the sign open, and the sign decides FPFH: normals are turned to the
viewpoint, so that two scans of one wall see the same side of it.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torchreg.entry import entry
from torchreg.errors import expect
from torchreg.geometry.eigen import least_eigenvector, symmetric_eigen
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.derivatives import derivative_wanted
from torchreg.geometry.numerics.sums import NEIGHBOR_LANES, lane_sums
from torchreg.native import KERNEL_TYPES, call, native, rows
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.neighborhoods import expect_rows
from torchreg.types.packing import spans


@entry
def estimate_normals(cloud: Clouds, near: Neighborhoods, *, viewpoint: Tensor | None = None) -> Clouds:
    """Clouds with unit normals that face the viewpoint.

    Args:
        cloud: P points.
        near: the support of every point (the paper: 2 m, 30 nearest), the point itself counted.
        viewpoint: (3,) or (B, 3) meters in the frame of ``points``; ``None`` takes that of the clouds, whether
            it is known or only assumed. Where there is none, normals are turned to the mean point of the cloud: a
            rule that moves with the cloud, but may turn them away from the scanner, as an assumed viewpoint may.

    Returns:
        The clouds with ``normals`` set. With fewer than 3 points in its support, or points all in one place, a
        point faces the viewpoint. Computed in float64; the same bits in any batch, with and without gradients.

        Gradients flow to points that require them, and to the viewpoint where a normal is its direction.
        They are those of the least eigenvector with the neighborhood and the sign held fixed, exact to second order
        where the least eigenvalue is single; directions that equal eigenvalues do not determine get none, so that
        coincident and collinear points have finite gradients. The backward pass recomputes chunks: memory stays
        that of one chunk.

    Raises:
        ValueError: shapes do not fit.

    Example:
        >>> import torch, torchreg as tr
        >>> points = torch.rand(50, 3) * torch.tensor([1.0, 1.0, 0.0])
        >>> flat = tr.Clouds(points, viewpoint=torch.tensor([[0.0, 0.0, 2.0]]))
        >>> near = tr.neighbors(flat, radius=0.5, max_neighbors=20)
        >>> tr.estimate_normals(flat, near).normals[0].round()
        tensor([0., 0., 1.])
    """
    expect_rows(near, cloud)
    if viewpoint is not None:
        expect(viewpoint.shape in ((3,), (len(cloud), 3)), "viewpoint", f"(3,) or ({len(cloud)}, 3)", viewpoint)
        viewpoint = viewpoint.expand(len(cloud), 3)
    towards = _facing(cloud, cloud.viewpoint if viewpoint is None else viewpoint)
    wanted = derivative_wanted(cloud.points, towards)
    given = (cloud.points, towards, near.index, near.valid)
    if native(*given) and cloud.points.dtype in KERNEL_TYPES and not wanted:
        return replace(cloud, normals=_normals_compiled(cloud.points, towards, near))
    x, y, z = (column.contiguous() for column in cloud.points.unbind(1))
    chunks = list(row_chunks(cloud.points.shape[0], near.max_neighbors))
    if not wanted:
        normals = torch.empty_like(cloud.points)
        for part in chunks:
            normals[part] = _oriented(x, y, z, towards[part], near, part)
    elif len(chunks) == 1:
        normals = _oriented(x, y, z, towards, near, chunks[0])
    else:
        parts = [
            checkpoint(_oriented, x, y, z, towards[part], near, part, use_reentrant=False, preserve_rng_state=False)
            for part in chunks
        ]
        normals = torch.cat(parts) if parts else cloud.points
    return replace(cloud, normals=normals.to(cloud.points.dtype))


def _normals_compiled(points: Tensor, towards: Tensor, near: Neighborhoods) -> Tensor:
    """Normals (P, 3) as ``_oriented`` computes them, in the dtype of the points."""
    points = points.detach().contiguous()
    out = torch.empty_like(points)
    slots, sizes = (*rows(near.index), *rows(near.valid)), (len(points), near.max_neighbors)
    call(f"normals_{KERNEL_TYPES[points.dtype]}", points, towards.detach().contiguous(), *slots, *sizes, out)
    return out


def _oriented(x: Tensor, y: Tensor, z: Tensor, towards: Tensor, near: Neighborhoods, part: slice) -> Tensor:
    """Normals (r, 3) float64 of some rows, turned to face ``towards`` (r, 3)."""
    covariance, count = covariances(x, y, z, near, part)
    values, vectors = symmetric_eigen(covariance)
    normal = vectors[..., 0]  # (r, 3): least spread
    if derivative_wanted(covariance):
        normal = least_eigenvector(covariance, values, vectors)
    spread = _sum_of_three(torch.diagonal(covariance, dim1=-2, dim2=-1))
    flat = ((count >= 3) & (spread > 0))[:, None]
    normal = torch.where(flat, normal, unit(towards))
    facing = _sum_of_three(normal * towards)[:, None]
    return torch.where(facing < 0, -normal, normal)


def unit(vectors: Tensor) -> Tensor:
    """Vectors (P, 3) of unit length; (0, 0, 1) for zero vectors."""
    square = _sum_of_three(vectors * vectors)[:, None]
    up = vectors.new_tensor([0.0, 0.0, 1.0])
    return torch.where(square > 0, vectors * torch.where(square > 0, square, torch.ones_like(square)).rsqrt(), up)


def _sum_of_three(values: Tensor) -> Tensor:
    """Sums (...) of values (..., 3), in their order."""
    return values[..., 0] + values[..., 1] + values[..., 2]


def _facing(cloud: Clouds, viewpoint: Tensor | None) -> Tensor:
    """The directions (P, 3) float64, from every point, to which its normal is turned."""
    out = torch.empty(cloud.points.shape[0], 3, dtype=torch.float64, device=cloud.device)
    for b, (begin, end) in enumerate(spans(cloud.offsets, cloud.points.shape[0])):
        points = cloud.points[begin:end].double()
        if begin == end:
            continue
        center = _mean(points)
        if viewpoint is not None:
            given = torch.isfinite(viewpoint[b]).all()
            center = torch.where(given, viewpoint[b].double(), center)
        out[begin:end] = center - points
    return out


def _mean(points: Tensor) -> Tensor:
    """The mean (3,) of points (P, 3), P > 0; in a captured graph, of any number of points, by torch's own sum."""
    return points.mean(dim=0) if torch.compiler.is_compiling() else lane_sums(points, dim=0) / points.shape[0]


def covariances(x: Tensor, y: Tensor, z: Tensor, near: Neighborhoods, part: slice) -> tuple[Tensor, Tensor]:
    """Covariance (r, 3, 3) float64 of the valid neighbors, and their number (r,)."""
    index, valid = near.index[part], near.valid[part]
    count = valid.sum(dim=1)
    share = 1 / count.clamp(min=1).double()
    weight = valid.double()
    offset = [((column[index] - column[part, None]) * weight) for column in (x, y, z)]
    mean = [lane_sums(axis, NEIGHBOR_LANES) * share for axis in offset]

    def moment(i: int, j: int) -> Tensor:
        return lane_sums(offset[i] * offset[j], NEIGHBOR_LANES) * share - mean[i] * mean[j]

    entries = {(i, j): moment(i, j) for i in range(3) for j in range(i, 3)}
    lines = [torch.stack([entries[min(i, j), max(i, j)] for j in range(3)], dim=-1) for i in range(3)]
    return torch.stack(lines, dim=-2), count
