"""Compatibility: nodes -> graph -> sets -> fit -> count. No sample is drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import at_least, expect
from torchreg.geometry.numerics.partition import partition
from torchreg.solvers.compatibility.graph import first_order
from torchreg.solvers.compatibility.nodes import choose_nodes
from torchreg.solvers.compatibility.sets import consensus_sets, fit_sets
from torchreg.solvers.points import MatchedPoints
from torchreg.solvers.result import solve
from torchreg.solvers.solver import Hypotheses, Solver
from torchreg.types import Clouds, Correspondences, RegistrationResult
from torchreg.types.packing import offsets_of

_LEAST = 3  # members with weight that a consensus set needs
_SETS = 1 << 12  # of several pairs, that are fitted together: a few hundred cost less than the operations on them


@checked_record
@dataclass(frozen=True, kw_only=True)
class CompatibilityOptions(Solver):
    """How sets of correspondences that keep their distances are formed and accepted.

    Attributes:
        inlier_threshold: meters, as every ``Solver``'s; also, two correspondences agree when their distances in the
            two clouds differ by less.
        nodes: correspondences that are compared each with each, at most 4,095; of more, those that agree with more
            others than chance gives are taken. Memory grows with the square, time with the cube.
        partners: in the first set of a seed, those that share the most partners with it.
        members: of its final set, the seed counted.
        local_optimization, scoring: as every ``Solver``'s.

    Example:
        >>> import torchreg as tr
        >>> tr.CompatibilityOptions(inlier_threshold=0.05).partners
        30
    """

    name: ClassVar[str] = "compatibility"

    nodes: int = 2000
    partners: int = 30
    members: int = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(self.nodes, "nodes", 3)
        expect(self.nodes <= 4095, "nodes", "at most 4095", self.nodes)
        at_least(self.members, "members", 3)
        at_least(self.partners, "partners", self.members - 1)

    def at_effort(self, effort: str) -> CompatibilityOptions:
        """At ``"fast"`` and ``"balanced"`` no more than 1,000 nodes."""
        return replace(self, nodes=min(self.nodes, 1000)) if effort in ("fast", "balanced") else self

    def propose(self, points: MatchedPoints) -> Hypotheses:
        """The transforms that the consensus sets of one pair give."""
        return next(self.propose_all([self], [points]))

    @classmethod
    def propose_all(
        cls, solvers: Sequence[CompatibilityOptions], points: Sequence[MatchedPoints]
    ) -> Iterator[Hypotheses]:
        """The transforms that consensus sets give, of every pair; the sets of several pairs are fitted together."""
        nodes = [min(pair.source.shape[1], solver.nodes) for solver, pair in zip(solvers, points, strict=True)]
        for run in partition(nodes, _SETS):
            yield from _propose_together(solvers[run], points[run])


@entry
def compatibility(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    options: CompatibilityOptions | Sequence[CompatibilityOptions] | None = None,
) -> RegistrationResult:
    """The transform that brings the most correspondences together, of every pair, found without samples.

    Every correspondence is the seed of a consensus set: of those that keep their distances to it, the ones that
    share the most partners with it (SC2-PCR: Chen et al., CVPR 2022, doi:10.1109/CVPR52688.2022.01287). The set
    gives a transform, and the transforms are scored on all correspondences, as those of ``ransac``. Nothing is drawn at
    random: the result is bit for bit the same in any batch and with any number of threads.

    Args:
        source: B clouds.
        target: B clouds.
        matches: correspondences between them, global rows.
        options: for all pairs, or one per pair; ``None`` for the defaults.

    Returns:
        RegistrationResult; ``hypotheses`` counts seeds, seeds with enough partners, and transforms scored. A pair
        with too few matches, or without a transform, has ``success`` false and says why. No gradients.

    Raises:
        ValueError: the numbers of pairs differ, or a correspondence names a row outside its pair's clouds.

    Example:
        >>> import torchreg as tr
        >>> problem = tr.synthetic.match_problem(500, 0.8)
        >>> result = tr.compatibility(problem.source, problem.target, problem.matches)
        >>> float(tr.metrics.rte(problem.T_target_source, result.T_target_source)) < 0.05
        True
    """
    return solve(source, target, matches, CompatibilityOptions() if options is None else options)


class _Sets(NamedTuple):
    """The consensus sets of one pair: its nodes (3, N) twice, and of S sets the members and weights (S, K)."""

    source: Tensor
    target: Tensor
    members: Tensor
    weights: Tensor


def _propose_together(solvers: Sequence[CompatibilityOptions], points: Sequence[MatchedPoints]) -> Iterator[Hypotheses]:
    sets = [_consensus(solver, pair) for solver, pair in zip(solvers, points, strict=True)]
    widest = max(each.members.shape[1] for each in sets)
    firsts = offsets_of(each.source.shape[1] for each in sets)[:-1].tolist()
    # a member more, of no weight, changes no sum
    members = torch.cat([_widened(each.members, widest) + first for each, first in zip(sets, firsts, strict=True)])
    weights = torch.cat([_widened(each.weights, widest) for each in sets])
    sources, targets = (torch.cat(side, dim=1) for side in zip(*(each[:2] for each in sets), strict=True))
    rotation, translation, solvable = fit_sets(sources, targets, members, weights)
    lengths = [len(each.members) for each in sets]
    fits = zip(rotation.split(lengths, -1), translation.split(lengths, -1), solvable.split(lengths), strict=True)
    for solver, pair, each, (R, t, fixed) in zip(solvers, points, sets, fits, strict=True):
        hypotheses = Hypotheses(pair, solver.inlier_threshold)
        hypotheses.drawn, hypotheses.kept = each.source.shape[1], len(each.members)
        hypotheses.explanation = (
            f"of {hypotheses.drawn} correspondences {hypotheses.kept} have {_LEAST - 1} partners that keep "
            f"their distances within {solver.inlier_threshold:g} m, and none with partners off one line"
        )
        passed = fixed.nonzero()[:, 0]
        hypotheses.add(R.index_select(-1, passed), t.index_select(-1, passed))
        yield hypotheses


def _consensus(solver: CompatibilityOptions, points: MatchedPoints) -> _Sets:
    """The sets with enough partners."""
    source, target, threshold = points.source, points.target, solver.inlier_threshold
    exact = _length_dtype(source, target, threshold)
    nodes = choose_nodes(source.to(exact), target.to(exact), threshold, solver.nodes)
    p, q = source.index_select(1, nodes), target.index_select(1, nodes)
    graph = first_order(p.to(exact), q.to(exact), threshold)
    members, weights = consensus_sets(graph, solver.partners, solver.members)
    filled = ((weights > 0).sum(dim=1) >= _LEAST).nonzero()[:, 0]
    return _Sets(p, q, members.index_select(0, filled), weights.index_select(0, filled))


def _widened(values: Tensor, width: int) -> Tensor:
    """(S, width) of (S, K), zeros behind."""
    return torch.nn.functional.pad(values, (0, width - values.shape[1]))


def _length_dtype(source: Tensor, target: Tensor, threshold: float) -> torch.dtype:
    """float32 where its rounding of a length stays far below the threshold, else float64."""
    reach = float(torch.maximum(source.abs().amax(), target.abs().amax()))
    return torch.float32 if 16 * reach * torch.finfo(torch.float32).eps < 0.1 * threshold else torch.float64
