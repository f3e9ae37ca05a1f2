"""Pairs that go through a solver together: none of them shows in the poses of another."""

from dataclasses import replace

import pytest
import torch
from determinism import THREADS, same_bits, threads
from problems import Problem, correspondence_problem, matched, pack_problems

import torchreg as tr
from torchreg.solvers.compatibility import compatibility_poses
from torchreg.solvers.loop import _groups
from torchreg.solvers.ransac import ransac_poses

COUNTS = (300, 41, 1100, 3, 60, 1024, 150)


def by_samples(source, target, matches, options):
    return ransac_poses(source, target, matches, options, 5)


SOLVERS = {
    "ransac": (by_samples, tr.RansacOptions(hypotheses=9000, confidence=1.0)),
    "compatibility": (compatibility_poses, tr.CompatibilityOptions(nodes=300)),
}


def problems():
    """Of very different numbers of matches; the one with three has no chance."""
    return [correspondence_problem(count, 0.7, noise=0.05, seed=count) for count in COUNTS]


def per_pair(options):
    """Thresholds of their own, and not all treated alike."""
    return [
        replace(options, inlier_threshold=0.15 + 0.01 * b, local_optimization=10 if b % 3 else 1)
        for b in range(len(COUNTS))
    ]


def run(solver, given, options):
    source, target, matches = pack_problems(given)
    return solver(source, target, matches, options)


def singles(solver, given, options):
    return [run(solver, [problem], [own])[0] for problem, own in zip(given, options, strict=True)]


def hopeless():
    """Matches on one point, too few matches, and points that are not finite."""
    point, rows = tr.Clouds(points=torch.ones(30, 3, dtype=torch.float64)), torch.arange(30)
    broken = tr.Clouds(points=torch.full((30, 3), torch.nan, dtype=torch.float64))
    none = torch.zeros(30, dtype=torch.bool)
    eye = torch.eye(4, dtype=torch.float64)[None]
    return [
        Problem(point, point, matched(rows, rows), eye, none),
        Problem(point, point, matched(rows[:2], rows[:2]), eye, none[:2]),
        Problem(broken, point, matched(rows, rows), eye, none),
    ]


@pytest.mark.parametrize("name", SOLVERS)
def test_a_batch_of_mixed_sizes_equals_its_pairs(name):
    solver, options = SOLVERS[name]
    given, own = problems(), per_pair(options)
    expected = singles(solver, given, own)
    assert sum(len(poses.support) > 0 for poses in expected) >= 5
    for order in (range(7), (4, 2, 6, 0, 3, 1, 5)):
        found = run(solver, [given[b] for b in order], [own[b] for b in order])
        assert all(same_bits(tuple(one), tuple(expected[b])) for one, b in zip(found, order, strict=True))


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize(("matches", "hypotheses"), [(1, 1), (700, 2000), (3000, 1 << 18)])
def test_the_size_of_a_group_does_not_show(name, matches, hypotheses, monkeypatch):
    solver, options = SOLVERS[name]
    given, own = problems(), per_pair(options)
    expected = run(solver, given, own)
    monkeypatch.setattr("torchreg.solvers.loop._GROUP_MATCHES", matches)
    monkeypatch.setattr("torchreg.solvers.loop._GROUP_HYPOTHESES", hypotheses)
    assert same_bits(tuple(map(tuple, run(solver, given, own))), tuple(map(tuple, expected)))


@pytest.mark.parametrize("name", SOLVERS)
def test_hopeless_pairs_in_between_change_nothing(name):
    solver, options = SOLVERS[name]
    given, own = problems()[:3], per_pair(options)[:3]
    expected = singles(solver, given, own)
    mixed = [given[0], *hopeless()[:2], given[1], hopeless()[2], given[2]]
    found = run(solver, mixed, [own[0], options, options, own[1], options, own[2]])
    assert all(same_bits(tuple(found[b]), tuple(one)) for b, one in zip((0, 3, 5), expected, strict=True))
    assert found[1].reason.startswith("no hypothesis left")
    assert found[2].reason.startswith("too few matches: 2")
    assert found[4].reason == "points that are not finite"
    assert all(len(found[b].support) == 0 and not found[b].inliers.numel() for b in (1, 2, 4))


@pytest.mark.parametrize("name", SOLVERS)
def test_the_number_of_threads_does_not_show(name):
    solver, options = SOLVERS[name]
    given, own = problems(), per_pair(options)
    found = []
    for number in THREADS:
        with threads(number):
            found.append(tuple(map(tuple, run(solver, given, own))))
    assert all(same_bits(one, found[0]) for one in found)


def test_groups_hold_every_pair_once_and_fit():
    counts = [5, 70_000, 3, 900, 900, 40_000, 8]
    order = sorted(range(7), key=counts.__getitem__)
    groups = list(_groups(order, counts))
    assert [b for group in groups for b in group] == order
    assert all(len(group) == 1 or len(group) * counts[group[-1]] <= 1 << 16 for group in groups)
    assert len(groups) == 3


def test_rows_outside_a_pair_are_refused_by_name():
    source, target, matches = pack_problems(problems()[:2])
    rows = matches.source.clone()
    rows[-1] = 0  # a row of the first pair
    wrong = replace(matches, source=rows)
    with pytest.raises(ValueError, match=r"matches\.source: expected rows from 300 to 340 in this pair"):
        compatibility_poses(source, target, wrong, [tr.CompatibilityOptions()] * 2)
