"""What a solver is: a record with a name and ``propose``, written outside of the package and used like those in it."""

import math
from dataclasses import FrozenInstanceError, dataclass, replace
from itertools import combinations

import pytest
import torch
from determinism import same_bits
from problems import correspondence_problem, matched, pack_problems

import torchreg as tr
from torchreg.solvers import SOLVERS, Hypotheses, MatchedPoints, PairPoses, poses_of_pairs, solve


@dataclass(frozen=True, kw_only=True)
class BestTriples(tr.Solver):
    """Kabsch on all triples of the ``best`` matches by score."""

    name = "best triples"
    best: int = 12

    def propose(self, points: MatchedPoints) -> Hypotheses:
        hypotheses = Hypotheses(points, self.inlier_threshold)
        best = points.score.argsort()[: self.best]
        triples = best[torch.tensor(list(combinations(range(len(best)), 3)))]
        T = tr.kabsch(points.source.t()[triples], points.target.t()[triples])
        hypotheses.drawn = hypotheses.kept = len(T)
        hypotheses.add(T[:, :3, :3].permute(1, 2, 0), T[:, :3, 3].t())
        return hypotheses


@dataclass(frozen=True, kw_only=True)
class Idle(tr.Solver):
    """Proposes nothing, and wants many matches."""

    name = "idle"

    @property
    def least_matches(self) -> int:
        return 10

    def propose(self, points: MatchedPoints) -> Hypotheses:
        assert float(points.source.mean(dim=1).abs().max()) < 1e-9
        assert float(points.target.mean(dim=1).abs().max()) < 1e-9
        return Hypotheses(points, self.inlier_threshold)


def problems():
    """Pairs of which the matcher scores the right matches better than most others."""
    return [correspondence_problem(count, 0.7, seed=count) for count in (100, 250, 70)]


def test_a_solver_from_outside_finds_the_truth():
    for problem in problems():
        result = solve(problem.source, problem.target, problem.matches, BestTriples())
        assert result.success.all()
        assert float(tr.metrics.rmse(problem.T_target_source, result.T_target_source, problem.source.points)) < 0.02
        assert torch.equal(result.inliers, problem.is_inlier)
        assert [int(number) for number in result.hypotheses] == [220, 220, 220]


def test_a_batch_of_it_equals_its_pairs_beside_other_solvers_too():
    given = problems()
    solvers = [BestTriples(), tr.RansacOptions(hypotheses=5000), BestTriples(best=9, inlier_threshold=0.1)]
    alone = [
        solve(one.source, one.target, one.matches, solver, seed=4) for one, solver in zip(given, solvers, strict=True)
    ]
    together = solve(*pack_problems(given), solvers, seed=4)
    for name in ("T_target_source", "inliers", "fitness", "inlier_rmse", "success"):
        assert same_bits(getattr(together, name), torch.cat([getattr(one, name) for one in alone])), name
    assert together.hypotheses.drawn.tolist() == [220, int(alone[1].hypotheses.drawn), 84]


def test_its_poses_are_distinct_and_refitted():
    problem = problems()[0]
    refitted, proposed = (
        poses_of_pairs(
            problem.source, problem.target, problem.matches, [BestTriples(scoring="count", local_optimization=rounds)]
        )[0]
        for rounds in (10, 0)
    )
    assert isinstance(refitted, PairPoses)
    assert refitted.support[0] >= proposed.support[0]
    assert refitted.error[0] < proposed.error[0]
    assert 1 < len(refitted.support) <= 16


def test_chance_is_no_success_for_it_either():
    problem = correspondence_problem(100, 1.0, seed=3)
    result = solve(problem.source, problem.target, problem.matches, BestTriples())
    assert result.success.tolist() == [False]
    assert result.failure[0].kind == "no consensus"


def test_a_pair_without_hypotheses_says_so():
    problem = correspondence_problem(30)
    result = solve(problem.source, problem.target, problem.matches, Idle())
    assert result.reason == ("no hypothesis left: of 0 begun 0 passed the first test, and none gave a transform",)
    few = matched(problem.matches.source[:9], problem.matches.target[:9])
    result = solve(problem.source, problem.target, few, Idle())
    assert result.reason == ("too few matches: 9, and a sample needs 10",)
    with pytest.raises(NotImplementedError, match="Solver proposes nothing"):
        solve(problem.source, problem.target, problem.matches, tr.Solver())


def test_the_public_functions_are_the_solvers_of_the_package():
    problem = correspondence_problem(150, 0.6)
    given = (problem.source, problem.target, problem.matches)
    assert same_bits(tr.ransac(*given), solve(*given, tr.RansacOptions()))
    assert same_bits(tr.compatibility(*given), solve(*given, tr.CompatibilityOptions()))
    assert {"ransac": tr.RansacOptions, "compatibility": tr.CompatibilityOptions} == SOLVERS
    assert all(name == solver.name for name, solver in SOLVERS.items())


@pytest.mark.parametrize("solver", [*SOLVERS.values(), BestTriples])
def test_every_solver_is_a_checked_record(solver):
    one = solver()
    assert one == solver() != solver(inlier_threshold=0.3)
    assert one.scaled(2.0) == replace(one, inlier_threshold=0.4)
    for name, value in (("inlier_threshold", 0.0), ("local_optimization", -1), ("scoring", "best")):
        with pytest.raises(ValueError, match=f"{name}: expected"):
            replace(one, **{name: value})
    with pytest.raises(FrozenInstanceError):
        one.scoring = "count"


def test_what_the_verdict_counts_is_the_solvers_word():
    assert (tr.RansacOptions(sample_size=4).least_matches, tr.RansacOptions().tests(70)) == (4, 70)
    assert (tr.CompatibilityOptions().least_matches, tr.CompatibilityOptions().tests(70)) == (3, math.inf)


def test_effort_bounds_the_nodes_that_are_compared():
    nodes = {
        effort: [tr.CompatibilityOptions(nodes=count).at_effort(effort).nodes for count in (300, 2000)]
        for effort in ("plain", "fast", "balanced", "thorough")
    }
    assert nodes == {"plain": [300, 2000], "fast": [300, 1000], "balanced": [300, 1000], "thorough": [300, 2000]}
    assert all(tr.RansacOptions().at_effort(effort) == tr.RansacOptions() for effort in nodes)
