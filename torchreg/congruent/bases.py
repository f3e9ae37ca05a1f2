"""Bases: four points of the source, nearly in one plane, whose diagonals cross.

The ratios in which the crossing cuts the diagonals do not change under a rigid (indeed under an affine) motion (Aiger,
Mitra and Cohen-Or, ACM Trans. Graph. 27(3), 2008, doi:10.1145/1360612.1360684). A base is drawn wide, since a small
error of its points then turns it little, but no wider than the overlap that is assumed. All bases are drawn together:
of many random triangles the largest, and to each the point in its plane that makes the widest quadrilateral.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.congruent.sides import CloudSide, cross, dot, unit
from torchreg.geometry.numerics.chunks import row_chunks

_TRIANGLES = 64  # random ones, of which a base takes the largest
_LEAST_SIDE = 0.2  # of the greatest width: points nearer to each other than this fix no turn
_INNER = 0.05  # the crossing lies at least this share of a diagonal away from its ends
_CANDIDATES = 512  # points of the source, of which the fourth is one
_ELEMENTS = 1 << 18

_PAIRINGS = ((0, 1, 2), (0, 2, 1), (1, 2, 0))
"""Corners (a, b, c) of a triangle such that a and b end one diagonal, c and the fourth point the other."""


class Bases(NamedTuple):
    """B bases; the diagonals go from corner 0 to 1 and from 2 to 3."""

    corners: Tensor  # (4, B) int64, rows of the source
    ratios: Tensor  # (2, B) float32, where the crossing lies along each diagonal

    def take(self, rows: Tensor | slice) -> Bases:
        """The bases ``rows`` (K,), in that order."""
        return Bases(self.corners[:, rows], self.ratios[:, rows])


def draw_bases(side: CloudSide, count: int, widest: float, tolerance: float, generator: torch.Generator) -> Bases:
    """Draw at most ``count`` bases, no side of which is wider than ``widest``, flat within ``tolerance``, meters."""
    number, points = side.points.shape[1], side.points
    # on the CPU, so that every device gets the same draws
    drawn = torch.randint(number, (3, count, _TRIANGLES), generator=generator).to(points.device)
    parts = []
    for rows in row_chunks(count, _CANDIDATES, _ELEMENTS):
        triangles, legal = _largest(points, drawn[:, rows], widest)
        bases, crossing = _fourth(points, triangles, widest, tolerance)
        parts.append(bases.take((legal & crossing).nonzero()[:, 0]))
    return Bases(*(torch.cat(part, dim=1) for part in zip(*parts, strict=True)))


def _largest(points: Tensor, drawn: Tensor, widest: float) -> tuple[Tensor, Tensor]:
    """Of triangles (3, B, T) the largest (3, B) that is neither too wide nor too narrow, and whether there is one."""
    a, b, c = (points[:, corner] for corner in drawn)
    u, v, w = b - a, c - a, c - b
    squares = torch.stack([dot(side, side) for side in (u, v, w)])
    narrow = _LEAST_SIDE * widest
    legal = (squares.amax(dim=0) <= widest * widest) & (squares.amin(dim=0) >= narrow * narrow)
    normal = cross(u, v)
    area = torch.where(legal, dot(normal, normal), 0.0)  # (B, T)
    best = area.argmax(dim=1, keepdim=True)
    return drawn.gather(2, best.expand(3, -1, -1))[..., 0], area.gather(1, best)[:, 0] > 0


def _fourth(points: Tensor, triangles: Tensor, widest: float, tolerance: float) -> tuple[Bases, Tensor]:
    """Bases that begin with triangles (3, B), and whether a fourth point was found for each."""
    corners = points[:, triangles]  # (3, 3, B): coordinates of corners
    normal = unit(cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    step = max(1, -(-points.shape[1] // _CANDIDATES))
    candidates = points[:, None, ::step]  # (3, 1, N)
    apart = [candidates - corners[:, k, :, None] for k in range(3)]  # (3, B, N) each
    squares = torch.stack([dot(each, each) for each in apart])  # (3, B, N)
    narrow = _LEAST_SIDE * widest
    near = (squares.amax(dim=0) <= widest * widest) & (squares.amin(dim=0) >= narrow * narrow)
    height = dot(apart[0], normal[..., None]).abs()
    legal = near & (height <= tolerance)
    quality = squares.amin(dim=0)
    tried = []
    for pairing in _PAIRINGS:
        first, second = _crossing(corners[:, pairing[0]], corners[:, pairing[1]], corners[:, pairing[2]], candidates)
        inside = torch.minimum(torch.minimum(first, 1 - first), torch.minimum(second, 1 - second)) > _INNER
        worth, place = torch.where(legal & inside, quality, -1.0).max(dim=1)  # (B,)
        ends = torch.stack([*(triangles[k] for k in pairing), step * place])
        tried.append((worth, ends, torch.stack([side.gather(1, place[:, None])[:, 0] for side in (first, second)])))
    worths, ends, ratios = (torch.stack(parts, dim=-1) for parts in zip(*tried, strict=True))  # (..., B, 3)
    most, best = worths.max(dim=-1, keepdim=True)
    return Bases(_chosen(ends, best), _chosen(ratios, best)), most[:, 0] > 0


def _chosen(values: Tensor, which: Tensor) -> Tensor:
    """(K, B) of (K, B, 3), by (B, 1)."""
    return values.gather(-1, which.expand(len(values), -1, -1))[..., 0]


def _crossing(a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    """Where the lines a b (3, B) and c d come nearest, d being any of (3, 1, N): shares of the way, (B, N) each."""
    u, v, w = (b - a)[..., None], d - c[..., None], (a - c)[..., None]
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    determinant = uu * vv - uv * uv
    crossing = determinant > 1e-6 * uu * vv
    safe = torch.where(crossing, determinant, torch.ones_like(determinant))
    first = torch.where(crossing, (uv * vw - vv * uw) / safe, -1.0)
    second = torch.where(crossing, (uu * vw - uv * uw) / safe, -1.0)
    return first, second
