"""Linear systems of a graph whose nodes have six unknowns each: sparse Cholesky factors by fronts, and marginals.

Nodes are eliminated in the order of least degree. Those with the same neighbors go together, so that a graph that is
dense, or has become so, is one front and one dense factor (Duff and Reid, The multifrontal solution of indefinite
sparse symmetric linear systems, ACM TOMS 1983, doi:10.1145/356044.356047). The diagonal blocks of the inverse follow
from the same fronts, the last one first, without the rest of the inverse (Takahashi, Fagan and Chin, 1973; Erisman and
Tinney, doi:10.1145/360680.360704).
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

_SIZE = 6


class Front(NamedTuple):
    """Nodes that are eliminated together."""

    nodes: tuple[int, ...]  # those that are eliminated, then their neighbors that are left, in the order of elimination
    pivots: int  # how many are eliminated
    parent: int  # the front that eliminates the first of those left; -1 where none is left
    places: Tensor  # (neighbors * 6,) rows of the parent's front that hold the neighbors
    diagonal: Tensor  # (pivots,) the eliminated nodes
    edges: Tensor  # (K,) edges of the eliminated nodes, but those to nodes eliminated before
    ends: Tensor  # (2, K) places of their ends among the nodes, the one that is eliminated first before the other
    forward: Tensor  # (K, 1, 1) bool, whether that is the first of the edge


class Factor(NamedTuple):
    """The factor of one front: [[L, 0], [X^T, .]]."""

    L: Tensor  # (P, P) lower triangle
    X: Tensor  # (P, Q)


class Elimination:
    """The order of elimination for a graph, and what can be done with it for any numbers of that pattern.

    Args:
        count: nodes.
        edges: pairs of different nodes, each pair once.
    """

    def __init__(self, count: int, edges: Iterable[tuple[int, int]]) -> None:
        edges = list(edges)
        order = _least_degree(count, edges)
        at = {node: number for number, (pivots, _) in enumerate(order) for node in pivots}
        position = {node: place for place, node in enumerate(node for pivots, _ in order for node in pivots)}
        rows = [[*pivots, *sorted(border, key=position.__getitem__)] for pivots, border in order]
        own: list[list[tuple[int, int, int, bool]]] = [[] for _ in order]
        inside = [{node: place for place, node in enumerate(nodes)} for nodes in rows]
        for number, (a, b) in enumerate(edges):
            front = min(at[a], at[b])
            forward = position[a] < position[b]
            first, second = (a, b) if forward else (b, a)
            own[front].append((number, inside[front][first], inside[front][second], forward))
        self.count = count
        self.fronts: list[Front] = []
        for number, (pivots, border) in enumerate(order):
            parent = min((at[node] for node in border), default=-1)
            places = [inside[parent][node] for node in rows[number][len(pivots) :]]
            self.fronts.append(
                Front(
                    tuple(rows[number]),
                    len(pivots),
                    parent,
                    _expanded(places),
                    torch.tensor(pivots, dtype=torch.int64),
                    *_edges_of(own[number]),
                )
            )

    def factor(self, diagonal: Tensor, between: Tensor) -> list[Factor] | None:
        """Factor the matrix with blocks (N, 6, 6) on the diagonal and (E, 6, 6) at the edges (first, second).

        ``None`` where it is not positive definite.
        """
        waiting: list[list[tuple[Tensor, Tensor]]] = [[] for _ in self.fronts]
        factors = []
        for number, front in enumerate(self.fronts):
            size, P = _SIZE * len(front.nodes), _SIZE * front.pivots
            blocks = diagonal.new_zeros(len(front.nodes), _SIZE, len(front.nodes), _SIZE)
            place = torch.arange(front.pivots)
            blocks[place, :, place] = diagonal[front.diagonal]
            own = between[front.edges]
            one, other = front.ends
            blocks[one, :, other] = torch.where(front.forward, own, own.transpose(1, 2))
            blocks[other, :, one] = torch.where(front.forward, own.transpose(1, 2), own)
            matrix = blocks.view(size, size)
            for rows, update in waiting[number]:
                matrix[rows[:, None], rows] += update
            waiting[number] = []
            L, info = torch.linalg.cholesky_ex(matrix[:P, :P])
            if int(info) != 0:
                return None
            X = torch.linalg.solve_triangular(L, matrix[:P, P:], upper=False)
            factors.append(Factor(L, X))
            if front.parent >= 0:
                waiting[front.parent].append((front.places, matrix[P:, P:] - X.t() @ X))
        return factors

    def solve(self, factors: list[Factor], right: Tensor) -> Tensor:
        """The solution (N, 6) for a right side (N, 6)."""
        x = right.clone()
        for front, (L, X) in zip(self.fronts, factors, strict=True):
            pivots, border = list(front.nodes[: front.pivots]), list(front.nodes[front.pivots :])
            y = torch.linalg.solve_triangular(L, x[pivots].view(-1, 1), upper=False)
            x[pivots] = y.view(-1, _SIZE)
            if border:
                x[border] -= (X.t() @ y).view(-1, _SIZE)
        for front, (L, X) in zip(reversed(self.fronts), reversed(factors), strict=True):
            pivots, border = list(front.nodes[: front.pivots]), list(front.nodes[front.pivots :])
            y = x[pivots].view(-1, 1)
            if border:
                y = y - X @ x[border].view(-1, 1)
            x[pivots] = torch.linalg.solve_triangular(L.t(), y, upper=True).view(-1, _SIZE)
        return x

    def marginals(self, factors: list[Factor]) -> Tensor:
        """The diagonal blocks (N, 6, 6) of the inverse."""
        result = torch.zeros(self.count, _SIZE, _SIZE, dtype=torch.float64)
        kept: dict[int, Tensor] = {}
        children = [0] * len(self.fronts)
        for front in self.fronts:
            if front.parent >= 0:
                children[front.parent] += 1
        for number in reversed(range(len(self.fronts))):
            front, (L, X) = self.fronts[number], factors[number]
            P = len(L)
            whole = L.new_empty(_SIZE * len(front.nodes), _SIZE * len(front.nodes))
            inverse = torch.cholesky_inverse(L)
            if front.parent >= 0:
                rest = kept[front.parent][front.places[:, None], front.places]
                children[front.parent] -= 1
                if children[front.parent] == 0:
                    del kept[front.parent]
                back = torch.linalg.solve_triangular(L.t(), X, upper=True)  # (P, Q)
                cross = -back @ rest
                whole[P:, P:], whole[:P, P:], whole[P:, :P] = rest, cross, cross.t()
                inverse = inverse - cross @ back.t()
            whole[:P, :P] = inverse
            if children[number]:
                kept[number] = whole
            for place, node in enumerate(front.nodes[: front.pivots]):
                block = whole[place * _SIZE : (place + 1) * _SIZE, place * _SIZE : (place + 1) * _SIZE]
                result[node] = (block + block.t()) / 2
        return result


def _least_degree(count: int, edges: list[tuple[int, int]]) -> list[tuple[list[int], list[int]]]:
    """The nodes that are eliminated together, in order, with their neighbors among those left."""
    near: list[set[int]] = [set() for _ in range(count)]
    for a, b in edges:
        near[a].add(b)
        near[b].add(a)
    heap = [(len(others), node) for node, others in enumerate(near)]
    heapq.heapify(heap)
    gone = [False] * count
    order = []
    while heap:
        degree, node = heapq.heappop(heap)
        if gone[node] or degree != len(near[node]):
            continue
        border = sorted(near[node])
        for other in border:
            near[other] |= near[node]
            near[other] -= {other, node}
        together = {other for other in border if len(near[other]) == len(border) - 1}
        left = [other for other in border if other not in together]
        for other in left:
            near[other] -= together
            heapq.heappush(heap, (len(near[other]), other))
        pivots = [node, *sorted(together)]
        for other in pivots:
            gone[other] = True
        order.append((pivots, left))
    return order


def _edges_of(own: list[tuple[int, int, int, bool]]) -> tuple[Tensor, Tensor, Tensor]:
    """The edges of a front, the places of their ends, and whether they run forward, as tensors."""
    rows = torch.tensor(own, dtype=torch.int64).view(-1, 4)
    return rows[:, 0], rows[:, 1:3].t(), rows[:, 3].bool()[:, None, None]


def _expanded(places: list[int]) -> Tensor:
    """The rows of blocks of six at these places."""
    return (torch.tensor(places, dtype=torch.int64)[:, None] * _SIZE + torch.arange(_SIZE)).view(-1)
