"""Nearest target points of moving source points, searched only where they may have changed.

The nearest are those in space, or in further dimensions too, such as color, which a motion does not change: then a
point moves no farther in all dimensions than in space, and what follows holds as it stands.

A source point at p had its nearest target points at distances d1 <= d2 <= ... <= dK. Now it is at p', a step
s = |p' - p| away. Every point but the first is at least d2 - s away now, so as long as the first is nearer than that,
it still is the nearest. Where it is not, the nearest of the K is the nearest of all if it is nearer than dK - s. And
where d1 - s is above the largest distance allowed, there is no correspondence, whichever is the nearest. So the
result is that of a full search, but in most iterations of ICP few points are searched.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather_columns
from torchreg.neighborhoods.kd_tree import fits_tree
from torchreg.neighborhoods.open3d_search import Tree
from torchreg.neighborhoods.point_index import nearest_of_all
from torchreg.refinement.blocks import BLOCK, Blocks
from torchreg.refinement.found import FoundRows
from torchreg.refinement.tree_search import TreeSearch

FEW = 4
"""Nearest points kept per search. Measured: 4 take the tree a third longer than 2, but few searches are repeated."""

Search = Callable[[Tensor], FoundRows]
"""From queries (Q, S) to their nearest, (Q, min(FEW, N))."""

_CHUNK_ROWS = 1 << 14  # rows decided at once: what they need stays in the cache
_ROUNDING = 1e-12  # relative, on distances: a bound that close is not relied on


@dataclass(frozen=True, eq=False)
class Target:
    """The target points of all pairs of a batch."""

    # (A, N) float64: x, y, z about each cloud's center, further dimensions of the search, other columns of the kind
    values: Tensor
    first: tuple[int, ...]  # for every pair, the row of its cloud's first point
    # for every pair, in the points of its cloud; rows count from the first. Pairs may share a cloud
    search: tuple[Search, ...]


class Correspondence:
    """Every source row's nearest target point under the last transforms given.

    Attributes:
        blocks: n blocks of the active pairs, those still being refined.
        pairs: the numbers of the active pairs in the batch.
        source: (S, n, 256), source points about their centers, and in further dimensions, if there are any, what
            stays as it is when they move.
        target: the target points of the whole batch.
        max_distance: (B,) meters, of the active pairs.
        moved: (S, n, 256), source points in the targets' frames.
        partner: (A, n, 256), the target's values at their nearest points.
        square: (n, 256) squared meters between them, in all S dimensions; any finite numbers where rows are not inside,
            and partners too.
        inside: (n, 256) bool, nearer than the largest distance.
    """

    _by_axis: tuple[str, ...] = ("source", "moved", "partner", "_decided_at", "_searched_at")
    _by_row: tuple[str, ...] = ("square", "inside", "_nearest", "_second", "_few", "_others")

    def __init__(self, blocks: Blocks, source: Tensor, target: Target, max_distance: Tensor) -> None:
        """No correspondences yet; source (S, n, 256) about its centers, ``max_distance`` (B,) meters."""
        self.blocks, self.target = blocks, target
        self.pairs = list(range(len(blocks.counts)))
        shape = source.shape[1:]
        self.source, self.max_distance = source, max_distance
        self.moved = torch.zeros_like(source)
        self.moved[3:] = source[3:]
        self.partner = source.new_zeros(len(target.values), *shape)
        self.square = source.new_zeros(shape)
        self.inside = torch.zeros(shape, dtype=torch.bool, device=source.device)
        self._begin()

    def _begin(self) -> None:
        """Nothing has been searched."""
        source, shape, never = self.source, self.square.shape, -torch.inf
        # when the partner was last decided: where, and bounds from below on the two least distances
        self._decided_at = torch.zeros_like(source)
        self._nearest, self._second = source.new_full(shape, never), source.new_full(shape, never)
        # when last searched: where, the nearest points' rows, and the distance of all others from below
        self._searched_at = torch.zeros_like(source)
        self._few = torch.zeros(*shape, FEW, dtype=torch.int64, device=source.device)
        self._others = source.new_full(shape, never)
        self._searched = False

    def apart(self, chunk: slice) -> Tensor:
        """Squared meters in space (k, 256) between some rows and their partners; finite where rows are not inside."""
        if len(self.source) == 3:
            return self.square[chunk]
        return _square(self.moved[:3, chunk], self.partner[:3, chunk])

    def keep(self, which: list[int]) -> Tensor:
        """Keep these of the active pairs, by their places among them; returns the numbers of the blocks that stay."""
        self.blocks, chosen = self.blocks.keep(which)
        self.pairs = [self.pairs[b] for b in which]
        self.max_distance = self.max_distance[which]
        for name in self._by_axis:
            setattr(self, name, getattr(self, name).index_select(1, chosen))
        for name in self._by_row:
            setattr(self, name, getattr(self, name).index_select(0, chosen))
        return chosen

    def narrow(self, max_distance: Tensor) -> None:
        """Lower the largest distances of the active pairs, (B,) meters."""
        self.max_distance = max_distance

    def move(self, rotation: Tensor, translation: Tensor) -> None:
        """Update the correspondences to R (B, 3, 3) and t (B, 3) of the active pairs."""
        limit = self.max_distance[self.blocks.pair][:, None]  # (n, 1)
        R, t = rotation[self.blocks.pair, :, :, None], translation[self.blocks.pair, :, None]
        pending = torch.empty_like(self.inside)
        for chunk in self.blocks.chunks():
            moved = self.moved[:, chunk]  # (S, k, 256), written in place
            _transform(self.source[:, chunk], R[chunk], t[chunk], moved)
            square = _square(moved, self.partner[: len(moved), chunk])
            step = _square(moved, self._decided_at[:, chunk]).sqrt_()
            first, second = square.sqrt(), self._second[chunk] - step
            known = _known(first, second, self._nearest[chunk] - step, limit[chunk])
            self.square[chunk] = square
            pending[chunk] = self.blocks.real[chunk] & ~known
        rows = pending.view(-1).nonzero().squeeze(1)
        if self._searched:
            decided = [self._choose(part, limit) for part in rows.split(_CHUNK_ROWS)]
            rows = rows[~torch.cat(decided)]
        self._search(rows)
        self._searched = True
        torch.lt(self.square, limit * limit, out=self.inside)
        self.inside &= self.blocks.real

    def _choose(self, rows: Tensor, limit: Tensor) -> Tensor:
        """Decide the rows (Q,) of all blocks among the few of their last search; returns where that suffices."""
        points = gather_columns(self.moved.flatten(1), rows)
        step = _square(points, gather_columns(self._searched_at.flatten(1), rows)).sqrt_()
        others = self._others.view(-1)[rows] - step
        first = self._decide(rows, points, self._few.view(-1, FEW)[rows], others)
        return _known(first, others, torch.minimum(first, others), limit.view(-1)[rows // BLOCK])

    def _search(self, rows: Tensor) -> None:
        """Search anew for the rows (Q,) of all blocks."""
        queries = gather_columns(self.moved.flatten(1), rows).t().contiguous()  # (Q, S)
        ends = torch.tensor(self.blocks.counts).cumsum(0) * BLOCK
        cuts = torch.searchsorted(rows, ends.to(rows.device)).tolist()  # rows ascend, so pair after pair
        few, beyond = rows.new_zeros(len(rows), FEW), queries.new_empty(len(rows))
        full = torch.zeros(len(rows), dtype=torch.bool, device=rows.device)
        begin = 0
        for end, search, first in _runs(self.target, self.pairs, cuts):
            if end > begin:
                nearest, beyond[begin:end] = search(queries[begin:end])
                width = nearest.shape[1]
                few[begin:end, :width] = nearest
                few[begin:end, width:] = nearest[:, -1:]  # a target of fewer points, which has no others
                few[begin:end] += first
                full[begin:end] = width == FEW
            begin = end
        for part in row_chunks(len(rows), 1, _CHUNK_ROWS):
            self._store(rows[part], queries[part].t().contiguous(), FoundRows(few[part], beyond[part]), full[part])

    def _store(self, rows: Tensor, points: Tensor, found: FoundRows, full: Tensor) -> None:
        """Store what a search found for the rows (Q,) at points (S, Q); the last one and the search bound all others.

        ``full`` (Q,) is false where the target has no others.
        """
        few = found.rows
        last = _square(points, gather_columns(self.target.values[: len(points)], few[:, -1])).sqrt_()
        others = torch.where(full, torch.minimum(last, found.beyond), torch.inf)
        few = few.sort(dim=1).values  # of equally near points the lower row counts
        self._decide(rows, points, few, others)
        self._few.view(-1, FEW).index_copy_(0, rows, few)
        self._others.view(-1).index_copy_(0, rows, others)
        _scatter(self._searched_at, rows, points)

    def _decide(self, rows: Tensor, points: Tensor, few: Tensor, others: Tensor) -> Tensor:
        """Store the nearest of ``few`` (Q, FEW) to points (S, Q), where all others are ``others`` (Q,) or more away."""
        square = _square(points[:, :, None], gather_columns(self.target.values[: len(points)], few))  # (Q, FEW)
        nearest, place = square.min(dim=1)
        chosen = few.gather(1, place[:, None])
        second = square.masked_fill_(few == chosen, torch.inf).amin(dim=1).sqrt_()
        first = nearest.sqrt()
        _scatter(self.partner, rows, gather_columns(self.target.values, chosen[:, 0]))
        _scatter(self._decided_at, rows, points)
        self.square.view(-1).index_copy_(0, rows, nearest)
        self._nearest.view(-1).index_copy_(0, rows, torch.minimum(first, others))
        self._second.view(-1).index_copy_(0, rows, torch.minimum(second, others))
        return first


def _runs(target: Target, pairs: list[int], ends: list[int]) -> Iterator[tuple[int, Search, int]]:
    """Runs of pairs with one target, which one call searches: where their rows end, the search, its first row."""
    for place, (pair, end) in enumerate(zip(pairs, ends, strict=True)):
        last = place + 1 == len(pairs)
        if last or target.search[pairs[place + 1]] is not target.search[pair]:
            yield end, target.search[pair], target.first[pair]


def _scatter(into: Tensor, rows: Tensor, values: Tensor) -> None:
    """Write values (A, Q) to the rows of all blocks of (A, n, 256)."""
    for line, value in zip(into.view(len(into), -1).unbind(0), values.unbind(0), strict=True):
        line.index_copy_(0, rows, value)


def _known(first: Tensor, others: Tensor, least: Tensor, limit: Tensor) -> Tensor:
    """Where the first is nearer than all others can be, or nothing can be within the limit."""
    slack = 1 - _ROUNDING
    return (first < others * slack) | (least * slack > limit)


def _transform(source: Tensor, R: Tensor, t: Tensor, out: Tensor) -> None:
    """R (k, 3, 3, 1) source (3, k, 256) + t (k, 3, 1), into ``out``; rows behind the first three stay."""
    x, y, z = source[:3].unbind(0)
    for i in range(3):
        torch.add(t[:, i], x * R[:, i, 0], out=out[i])
        out[i].add_(y * R[:, i, 1]).add_(z * R[:, i, 2])


def _square(left: Tensor, right: Tensor) -> Tensor:
    """Squared distances between (S, ...) and (S, ...)."""
    first, *others = (left - right).unbind(0)
    total = first.mul_(first)
    for each in others:
        total.add_(each.mul_(each))
    return total


def few_nearest(points: Tensor) -> Search:
    """The search in ``points`` (N, 3) float64, N > 0: by a tree on the CPU, by comparing all pairs elsewhere."""
    if fits_tree(points):
        return TreeSearch(points, FEW)
    if points.device.type == "cpu":
        tree = Tree(points)
        return lambda queries: FoundRows.of_all(tree.nearest(queries, FEW))
    return all_pairs(points)


def all_pairs(points: Tensor, max_bytes: int = 256 * 2**20) -> Search:
    """The search that compares every query with every point, in chunks of ``max_bytes``."""
    return lambda queries: FoundRows.of_all(nearest_of_all(queries, points, FEW, max_bytes))
