"""One side, source or target, of a group of pairs: what is looked at of every scan, in step.

Coordinates stand apart, (3, G, L), and the samples of scans are filled up with zeros to one length L, so that one
operation serves the poses of all pairs and sums keep their order (``sums``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.neighborhoods.point_index import PointIndex
from torchreg.verification.cells import Cells, can_be_near, cells_of
from torchreg.verification.free_space import RangeImages, side_by_side
from torchreg.verification.poses import runs_of
from torchreg.verification.sums import padded
from torchreg.verification.view import View


class Side(NamedTuple):
    """One side of G pairs.

    Attributes:
        points: (3, G, L) float32, meters, the sample of every scan.
        normals: (3, G, L) float32, or ``None``.
        colors: (3, G, L) float64, or ``None``.
        real: (G, L) bool, false where a sample is filled up.
        counts: (G,) float64, points of every sample.
        all_points: (3, P) float32, all points of all scans.
        all_normals: (3, P) float32, or ``None``.
        all_colors: (3, P) float64, or ``None``.
        first: for every scan, the row of its first point there.
        points_of: for every scan, how many points it has.
        origin: (G, 3) float64, meters.
        faced: (G,) bool, whether normals point to a known scanner.
        cells: where those points are near, as near as the pair's threshold.
        trees: over the points of every scan.
        images: of those scanners that have one, ``None`` where none has.
        image: (G,) int64, which of the images is the scan's; -1 where it has none.
    """

    points: Tensor
    normals: Tensor | None
    colors: Tensor | None
    real: Tensor
    counts: Tensor
    all_points: Tensor
    all_normals: Tensor | None
    all_colors: Tensor | None
    first: Sequence[int]
    points_of: Sequence[int]
    origin: Tensor
    faced: Tensor
    cells: Cells
    trees: Sequence[PointIndex]
    images: RangeImages | None
    image: Tensor


def in_step(views: Sequence[View], threshold: Tensor) -> Side:
    """Put G scans, of pairs with thresholds (G,), beside each other; all have normals (colors), or none has."""
    device = views[0].points.device
    lengths, sizes = [len(view.sample) for view in views], [len(view.points) for view in views]
    firsts = [sum(sizes[:number]) for number in range(len(sizes))]
    width = padded(max(lengths))
    place = torch.arange(width, device=device)
    counts = torch.tensor(lengths, device=device)
    real = place < counts[:, None]  # (G, L)
    rows = torch.zeros(real.shape, dtype=torch.int64, device=device)
    rows[real] = torch.cat([view.sample + first for view, first in zip(views, firsts, strict=True)])

    def planes(parts: Sequence[Tensor | None]) -> Tensor | None:
        present = [part for part in parts if part is not None]
        return torch.cat(present).t().contiguous() if present else None

    def sampled(values: Tensor | None) -> Tensor | None:
        return None if values is None else values[:, rows].masked_fill_(~real, 0.0)

    points = torch.cat([view.points for view in views]).t().contiguous()
    normals, colors = planes([view.normals for view in views]), planes([view.colors for view in views])
    colors = None if colors is None else colors.double()
    images = [view.image for view in views if view.image is not None]
    numbers = torch.tensor([view.image is not None for view in views]).cumsum(0) - 1
    numbers[torch.tensor([view.image is None for view in views])] = -1
    return Side(
        points=points[:, rows].masked_fill_(~real, 0.0),
        normals=sampled(normals),
        colors=sampled(colors),
        real=real,
        counts=counts.double(),
        all_points=points,
        all_normals=normals,
        all_colors=colors,
        first=firsts,
        points_of=sizes,
        origin=torch.stack([view.origin for view in views]),
        faced=torch.tensor([view.faced for view in views], device=device),
        cells=cells_of(points, sizes, threshold),
        trees=[view.tree for view in views],
        images=side_by_side(images) if images else None,
        image=numbers.to(device),
    )


class Partners(NamedTuple):
    """The nearest points of rows of queries, of those that have one within the threshold.

    Attributes:
        row: (R, L) int64, among all points of the side; any legal row where there is none.
        square: (R, L) squared meters, of others infinite or beyond the squared threshold.
    """

    row: Tensor
    square: Tensor


def partners(side: Side, pair: Tensor, moved: Tensor, real: Tensor) -> Partners:
    """The nearest of a side's points.

    Args:
        side: of G pairs.
        pair: (R,) int64, ascending, which pair each row of queries belongs to.
        moved: (3, R, L) float32, queries in the frame of the side, meters.
        real: (R, L) bool, false where a row is filled up.
    """
    asked = (can_be_near(side.cells, pair, moved) & real).view(-1).nonzero()[:, 0]  # (Q,)
    queries = moved.view(3, -1).index_select(1, asked).t().contiguous()
    row, square = torch.zeros_like(asked), queries.new_zeros(len(asked))
    runs = runs_of(pair)
    ends = torch.tensor([run.end for run in runs], device=pair.device) * moved.shape[2]
    begin = 0
    for run, end in zip(runs, torch.searchsorted(asked, ends).tolist(), strict=True):
        if end > begin:
            found = side.trees[run.pair].nearest(queries[begin:end])
            torch.add(found.index, side.first[run.pair], out=row[begin:end])
            square[begin:end] = found.sq_distance
        begin = end
    rows = torch.zeros(moved.shape[1:], dtype=torch.int64, device=moved.device)
    squares = torch.full_like(moved[0], float("inf"))
    rows.view(-1)[asked], squares.view(-1)[asked] = row, square
    return Partners(rows, squares)


def gathered(planes: Tensor, row: Tensor) -> Tensor:
    """Columns of (C, P) at rows of any shape: (C, ...)."""
    flat = row.reshape(-1)
    return torch.stack([plane.index_select(0, flat) for plane in planes.unbind(0)]).view(len(planes), *row.shape)


def rotated(rotation: Tensor, planes: Tensor) -> Tensor:
    """R (R, 3, 3) times vectors (3, R, L), with the operations of ``apply_rotation``."""
    x, y, z = planes.unbind(0)
    out = torch.empty(3, *torch.broadcast_shapes(x.shape, (len(rotation), 1)), dtype=planes.dtype, device=x.device)
    for i in range(3):
        torch.mul(rotation[:, i, 0, None], x, out=out[i])
        out[i].add_(rotation[:, i, 1, None] * y).add_(rotation[:, i, 2, None] * z)
    return out
