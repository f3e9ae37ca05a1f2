"""Normals whose signs agree along surfaces, for clouds whose scanner is not known.

The sign of a normal is carried from point to neighbor along a minimum spanning forest of the neighborhood graph, where
an edge costs 1 - |n_i . n_j| (Hoppe et al., SIGGRAPH 1992, doi:10.1145/133994.134011), so that sharp edges come last.
The forest grows as Boruvka's does: every tree takes its cheapest edge to another, all at once, and the trees at its two
ends agree on a sign. Every tree at the end, a connected surface, is turned outwards as a whole.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.numerics.sums import lane_sums
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.packing import spans

_NEIGHBORS = 10  # of every point, to which its sign may be carried
_TRUSTED = 0.9  # share of neighbors that agree on the side of their surface, where sides are meant


def orient_along_surfaces(cloud: Clouds, near: Neighborhoods) -> Clouds:
    """Clouds whose normals keep their lines and have signs that agree along surfaces.

    Args:
        cloud: P points with unit normals, signs unimportant.
        near: neighborhoods of the points; the nearest ten other points count.

    Returns:
        The clouds with normals that point away from the mean point of their cloud, on the whole of every connected
        surface: outwards for a body that was seen from outside, away from the scanner for a room. Which of both it is
        cannot be told from the points. The same bits in any batch. No gradients.

    Raises:
        ValueError: no normals, or neighborhoods of other points.
    """
    if cloud.normals is None:
        raise ValueError("cloud: expected normals (estimate_normals gives them), got none")
    expect(len(near) == len(cloud.points), "near", f"neighborhoods of {len(cloud.points)} points", len(near))
    normals = cloud.normals.detach()
    tree, sign = _signs(normals, _edges(normals, near), len(normals))
    outwards = _outwards(cloud, normals * sign[:, None])
    pull = torch.zeros(len(normals), dtype=torch.int64, device=normals.device)
    pull = pull.index_add_(0, tree, outwards)  # whole numbers, which have no order
    sign = torch.where(pull[tree] < 0, -sign, sign)
    return replace(cloud, normals=normals * sign[:, None])


def orient_like(cloud: Clouds, hints: Tensor, near: Neighborhoods) -> Clouds:
    """Clouds whose normals take the sides of others, such as those of a file, where these agree among neighbors.

    Args:
        cloud: P points with unit normals.
        hints: (P, 3) normals whose sign counts; zero where there is none. Where neighbors in a cloud disagree on
            theirs, as where an eigenvector's sign was left to chance, all of that cloud's are ignored.
        near: neighborhoods of the points.

    Returns:
        The clouds with normals that keep their lines. No gradients.
    """
    if cloud.normals is None:
        raise ValueError("cloud: expected normals (estimate_normals gives them), got none")
    index, valid = near.index[:, : _NEIGHBORS + 1], near.valid[:, : _NEIGHBORS + 1]
    given = (hints != 0).any(dim=1)
    compared = valid & given[:, None] & given[index] & (index != torch.arange(len(index), device=index.device)[:, None])
    cosine = (hints[:, None] * hints[index]).sum(dim=2)
    agreeing, all_compared = (compared & (cosine > 0)).sum(dim=1), compared.sum(dim=1)
    trusted = torch.zeros_like(given)
    for begin, end in spans(cloud.offsets):
        trusted[begin:end] = agreeing[begin:end].sum() >= _TRUSTED * all_compared[begin:end].sum()
    against = (cloud.normals * hints).sum(dim=1) < 0
    return replace(cloud, normals=torch.where((trusted & against)[:, None], -cloud.normals, cloud.normals))


class _Edges(NamedTuple):
    """Edges of the neighborhood graph, the cheapest first."""

    one: Tensor  # (E,) int64, rows of the points at both ends
    other: Tensor
    agree: Tensor  # (E,) +1 or -1, the sign that the normals at both ends have to each other


def _edges(normals: Tensor, near: Neighborhoods) -> _Edges:
    width = min(_NEIGHBORS + 1, near.max_neighbors)
    one = torch.arange(len(near), device=normals.device)[:, None].expand(-1, width)
    other, valid = near.index[:, :width], near.valid[:, :width]
    cosine = (normals[one] * normals[other]).double().sum(dim=2)
    kept = valid & (one != other)
    one, other, cosine = one[kept], other[kept], cosine[kept]
    order = (1 - cosine.abs()).sort(stable=True).indices
    one, other = one[order], other[order]
    return _Edges(one, other, torch.where(cosine[order] < 0, -1.0, 1.0).to(normals))


def _signs(normals: Tensor, edges: _Edges, count: int) -> tuple[Tensor, Tensor]:
    """The tree (P,) that every point ends in, and its sign (P,) there."""
    tree = torch.arange(count, device=normals.device)
    sign = torch.ones(count, dtype=normals.dtype, device=normals.device)
    one, other, agree = edges
    while True:
        apart = (tree[one] != tree[other]).nonzero()[:, 0]  # edges inside a tree never count again
        if len(apart) == 0:
            return tree, sign
        one, other, agree = one[apart], other[apart], agree[apart]
        parent, turn = _joined(tree[one], tree[other], agree * sign[one] * sign[other], count)
        sign = sign * turn[tree]
        tree = parent[tree]


def _joined(one: Tensor, other: Tensor, agree: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Where every tree (count,) goes, and the sign it takes there; ``one`` and ``other`` (E,) are trees, by cost."""
    place = torch.arange(len(one), device=one.device)
    cheapest = torch.full((count,), len(one), device=one.device)
    cheapest = cheapest.scatter_reduce_(0, torch.cat([one, other]), place.repeat(2), "amin")
    parent = torch.arange(count, device=one.device)
    moves = cheapest < len(one)
    edge = cheapest.clamp(max=len(one) - 1)
    far = torch.where(one[edge] == parent, other[edge], one[edge])
    turn = torch.where(moves, agree[edge], 1.0).to(agree)
    goal = torch.where(moves, far, parent)
    # two trees that chose the same edge choose each other: the lower one stays
    stays = (goal[goal] == parent) & (parent < goal)
    goal, turn = torch.where(stays, parent, goal), torch.where(stays, 1.0, turn).to(agree)
    for _ in range(max(1, count.bit_length())):  # each step doubles the way that is gone
        goal, turn = goal[goal], turn * turn[goal]
    return goal, turn


def _outwards(cloud: Clouds, normals: Tensor) -> Tensor:
    """(P,) int64: 1 where a normal points away from the mean point of its cloud, -1 where it points there."""
    out = torch.zeros(len(normals), dtype=torch.int64, device=normals.device)
    for begin, end in spans(cloud.offsets):
        if end > begin:
            points = cloud.points[begin:end].detach().double()
            apart = points - lane_sums(points, dim=0) / len(points)
            out[begin:end] = (normals[begin:end] * apart).sum(dim=1).sign().long()
    return out
