"""The hypotheses of one pair by compatibility: nodes -> graph -> sets -> fit -> count."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.compatibility.graph import first_order
from torchreg.compatibility.nodes import choose_nodes
from torchreg.compatibility.sets import consensus_sets, fit_sets
from torchreg.hypotheses import Found, MatchedPoints, Proposals, proposal_dtype
from torchreg.hypotheses.scoring import correspondence_vectors, propose_counts
from torchreg.types import CompatibilityOptions

LEAST = 3
"""Correspondences that fix a transform, and members with weight that a consensus set needs."""


def solve(points: MatchedPoints, options: CompatibilityOptions) -> Found:
    """Find the transforms that consensus sets give.

    Args:
        points: of one pair.
        options: sizes of the sets, and what is an inlier.
    """
    source, target, threshold = points.source, points.target, options.inlier_threshold
    exact = _length_dtype(source, target, threshold)
    nodes = choose_nodes(source.to(exact), target.to(exact), threshold, options.nodes)
    p, q = source[:, nodes], target[:, nodes]
    graph = first_order(p.to(exact), q.to(exact), threshold)
    members, weights = consensus_sets(graph, options.partners, options.members)
    filled = ((weights > 0).sum(dim=1) >= LEAST).nonzero()[:, 0]
    rotation, translation, solvable = fit_sets(p, q, members[filled], weights[filled])
    passed = solvable.nonzero()[:, 0]
    if len(passed) == 0:
        reason = (
            f"no hypothesis left: of {len(nodes)} correspondences {len(filled)} have {LEAST - 1} partners that keep "
            f"their distances within {threshold:g} m, and none with partners off one line"
        )
        return Found(None, len(nodes), len(filled), 0, reason)
    dtype = proposal_dtype(source, target, threshold)
    rotation, translation = rotation[..., passed], translation[:, passed]
    near = (rotation.to(dtype), translation.to(dtype))
    proposals = Proposals(source.device, dtype)
    proposals.add(*near, propose_counts(*near, correspondence_vectors(source.to(dtype), target.to(dtype)), threshold))
    return Found(proposals, len(nodes), len(filled), len(passed), "")


def _length_dtype(source: Tensor, target: Tensor, threshold: float) -> torch.dtype:
    """float32 where its rounding of a length stays far below the threshold, else float64."""
    reach = float(torch.maximum(source.abs().amax(), target.abs().amax()))
    return torch.float32 if 16 * reach * torch.finfo(torch.float32).eps < 0.1 * threshold else torch.float64
