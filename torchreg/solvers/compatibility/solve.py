"""The hypotheses of pairs by compatibility: nodes -> graph -> sets -> fit -> count.

The sets of several pairs are fitted together, since a few hundred of them cost less than the operations on them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.solvers import Found, MatchedPoints, Proposals, proposal_dtype
from torchreg.solvers.compatibility.graph import first_order
from torchreg.solvers.compatibility.nodes import choose_nodes
from torchreg.solvers.compatibility.sets import consensus_sets, fit_sets
from torchreg.solvers.scoring import correspondence_vectors, propose_counts
from torchreg.types import CompatibilityOptions, Failure

LEAST = 3
"""Correspondences that fix a transform, and members with weight that a consensus set needs."""

_SETS = 1 << 12  # of several pairs, that are fitted together


def solve(points: Sequence[MatchedPoints], options: Sequence[CompatibilityOptions]) -> Iterator[Found]:
    """Find the transforms that consensus sets give, of every pair.

    Args:
        points: of each pair.
        options: sizes of the sets, and what is an inlier, of each.
    """
    begin = waiting = 0
    for end, (own, option) in enumerate(zip(points, options, strict=True), start=1):
        waiting += min(own.source.shape[1], option.nodes)
        if waiting >= _SETS or end == len(points):
            yield from _solve_together(points[begin:end], options[begin:end])
            begin, waiting = end, 0


class _Sets(NamedTuple):
    """The consensus sets of one pair: its nodes (3, N) twice, and of S sets the members and weights (S, K)."""

    source: Tensor
    target: Tensor
    members: Tensor
    weights: Tensor


def _solve_together(points: Sequence[MatchedPoints], options: Sequence[CompatibilityOptions]) -> Iterator[Found]:
    sets = [_sets(own, option) for own, option in zip(points, options, strict=True)]
    widest = max(each.members.shape[1] for each in sets)
    firsts = [0]
    for each in sets:
        firsts.append(firsts[-1] + each.source.shape[1])
    # a member more, of no weight, changes no sum
    members = torch.cat([_widened(each.members, widest) + first for each, first in zip(sets, firsts, strict=False)])
    weights = torch.cat([_widened(each.weights, widest) for each in sets])
    sources, targets = (torch.cat(side, dim=1) for side in zip(*(each[:2] for each in sets), strict=True))
    rotation, translation, solvable = fit_sets(sources, targets, members, weights)
    lengths = [len(each.members) for each in sets]
    fits = zip(rotation.split(lengths, -1), translation.split(lengths, -1), solvable.split(lengths), strict=True)
    for own, option, each, (R, t, fixed) in zip(points, options, sets, fits, strict=True):
        passed = fixed.nonzero()[:, 0]
        yield _found(own, option, each, R.index_select(-1, passed), t.index_select(-1, passed))


def _sets(points: MatchedPoints, options: CompatibilityOptions) -> _Sets:
    """Those with partners enough."""
    source, target, threshold = points.source, points.target, options.inlier_threshold
    exact = _length_dtype(source, target, threshold)
    nodes = choose_nodes(source.to(exact), target.to(exact), threshold, options.nodes)
    p, q = source.index_select(1, nodes), target.index_select(1, nodes)
    graph = first_order(p.to(exact), q.to(exact), threshold)
    members, weights = consensus_sets(graph, options.partners, options.members)
    filled = ((weights > 0).sum(dim=1) >= LEAST).nonzero()[:, 0]
    return _Sets(p, q, members.index_select(0, filled), weights.index_select(0, filled))


def _found(
    points: MatchedPoints, options: CompatibilityOptions, sets: _Sets, rotation: Tensor, translation: Tensor
) -> Found:
    """The outcome for one pair, of the transforms (3, 3, H), (3, H) of its sets."""
    source, target, threshold = points.source, points.target, options.inlier_threshold
    nodes, filled, passed = sets.source.shape[1], len(sets.members), translation.shape[1]
    if passed == 0:
        text = (
            f"no hypothesis left: of {nodes} correspondences {filled} have {LEAST - 1} partners that keep "
            f"their distances within {threshold:g} m, and none with partners off one line"
        )
        return Found(None, nodes, filled, 0, Failure("no hypothesis", text, {"drawn": nodes, "kept": filled}))
    dtype = proposal_dtype(source, target, threshold)
    near = (rotation.to(dtype), translation.to(dtype))
    proposals = Proposals(source.device, dtype)
    proposals.add(*near, propose_counts(*near, correspondence_vectors(source.to(dtype), target.to(dtype)), threshold))
    return Found(proposals, nodes, filled, passed, None)


def _widened(values: Tensor, width: int) -> Tensor:
    """(S, width) of (S, K), zeros behind."""
    return torch.nn.functional.pad(values, (0, width - values.shape[1]))


def _length_dtype(source: Tensor, target: Tensor, threshold: float) -> torch.dtype:
    """float32 where its rounding of a length stays far below the threshold, else float64."""
    reach = float(torch.maximum(source.abs().amax(), target.abs().amax()))
    return torch.float32 if 16 * reach * torch.finfo(torch.float32).eps < 0.1 * threshold else torch.float64
