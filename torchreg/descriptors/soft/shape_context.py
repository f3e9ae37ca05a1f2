"""3D shape contexts with gradients: neighbors whose votes pass from cell to cell."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.descriptors.soft.angle import angle
from torchreg.descriptors.soft.grids import grid_votes
from torchreg.descriptors.soft.pairs import distinct
from torchreg.descriptors.soft.rows import Piece, by_rows
from torchreg.descriptors.soft.votes import bin_shares
from torchreg.types import Neighborhoods


def soft_shape_context(
    points: Tensor,
    frames: Tensor,
    votes: Tensor,
    near: Neighborhoods,
    radius: Tensor,
    *,
    bins: tuple[int, int, int],
    edges: tuple[float, ...],
    bandwidth: float,
) -> Tensor:
    """(P, product of bins) sums of the votes (P,) of neighbors in each cell, before volumes.

    ``frames`` (P, 3, 3) are those of ``torchreg.shape_context``, ``radius`` (P, 1) that of the neighborhoods and
    ``edges`` where cells of radius end, as parts of it. Gradients flow to points and frames.
    """
    size = bins[0] * bins[1] * bins[2]
    if len(points) == 0:
        return points.new_empty(0, size)
    ends = points.new_tensor((0.0, *edges[1:]))

    def context(piece: Piece) -> Tensor:
        return _context(piece, bins, ends, bandwidth)

    table = torch.cat([points, frames.flatten(1), radius, votes[:, None]], dim=1)
    return by_rows(context, table, near, width=max(near.max_neighbors, size))


def _context(piece: Piece, bins: tuple[int, int, int], ends: Tensor, bandwidth: float) -> Tensor:
    """Counts (r, product of bins) of points whose columns are x, y, z, the frame, the radius and the vote."""
    dx, dy, dz = ((piece.neighbor[i] - piece.query[i]) / piece.query[12] for i in range(3))  # parts of the radius
    x, y, z = (dx * piece.query[axis] + dy * piece.query[axis + 1] + dz * piece.query[axis + 2] for axis in (3, 6, 9))
    square, across = dx * dx + dy * dy + dz * dz, x * x + y * y
    apart = distinct(square) & (piece.votes != 0)
    framed = apart & distinct(across + z * z)
    aside = framed & distinct(across)
    azimuth = angle(torch.where(aside, y, 0), torch.where(aside, x, 1)) * (0.5 / math.pi)
    azimuth = azimuth + (azimuth.detach() < 0).to(azimuth.dtype)
    distance = torch.where(apart, torch.where(apart, square, 1).sqrt(), 0)
    height = torch.where(aside, across, 1).sqrt() * aside
    elevation = angle(torch.where(framed, height, 0), torch.where(framed, z, 1)) * (1 / math.pi)
    shares = (
        bin_shares(azimuth, bins[0], bandwidth, circular=True),
        bin_shares(elevation, bins[1], bandwidth),
        bin_shares(distance.clamp(max=1), bins[2], bandwidth, edges=ends.expand(len(distance), -1)),
    )
    return grid_votes(shares, framed.to(square.dtype) * piece.neighbor[13].detach(), bins)
