"""Pairs that go through a solver together: none of them shows in the poses of another."""

from dataclasses import replace

import pytest
import torch
from determinism import THREADS, same_bits, threads
from problems import MatchProblem, correspondence_problem, matched, pack_problems

import torchreg as tr
from torchreg.solvers import batch as module
from torchreg.solvers import poses_of_pairs

COUNTS = (300, 41, 1100, 3, 60, 1024, 150)


OPTIONS = {
    "ransac": tr.RansacOptions(hypotheses=9000, confidence=1.0),
    "compatibility": tr.CompatibilityOptions(nodes=300),
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


def run(given, options):
    return poses_of_pairs(*pack_problems(given), options, 5)


def singles(given, options):
    return [run([problem], [own])[0] for problem, own in zip(given, options, strict=True)]


def hopeless():
    """Matches on one point, too few matches, and points that are not finite."""
    point, rows = tr.Clouds(points=torch.ones(30, 3, dtype=torch.float64)), torch.arange(30)
    broken = tr.Clouds(points=torch.full((30, 3), torch.nan, dtype=torch.float64))
    none = torch.zeros(30, dtype=torch.bool)
    eye = torch.eye(4, dtype=torch.float64)[None]
    return [
        MatchProblem(point, point, matched(rows, rows), eye, none),
        MatchProblem(point, point, matched(rows[:2], rows[:2]), eye, none[:2]),
        MatchProblem(broken, point, matched(rows, rows), eye, none),
    ]


@pytest.mark.parametrize("name", OPTIONS)
def test_a_batch_of_mixed_sizes_equals_its_pairs(name):
    options = OPTIONS[name]
    given, own = problems(), per_pair(options)
    expected = singles(given, own)
    assert sum(len(poses.support) > 0 for poses in expected) >= 5
    for order in (range(7), (4, 2, 6, 0, 3, 1, 5)):
        found = run([given[b] for b in order], [own[b] for b in order])
        assert all(same_bits(tuple(one), tuple(expected[b])) for one, b in zip(found, order, strict=True))


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize(("matches", "hypotheses"), [(1, 1), (700, 2000), (3000, 1 << 18)])
def test_the_size_of_a_group_does_not_show(name, matches, hypotheses, monkeypatch):
    options = OPTIONS[name]
    given, own = problems(), per_pair(options)
    expected = run(given, own)
    monkeypatch.setattr("torchreg.solvers.batch._GROUP_MATCHES", matches)
    monkeypatch.setattr("torchreg.solvers.batch._GROUP_HYPOTHESES", hypotheses)
    assert same_bits(tuple(map(tuple, run(given, own))), tuple(map(tuple, expected)))


@pytest.mark.parametrize("name", OPTIONS)
def test_hopeless_pairs_in_between_change_nothing(name):
    options = OPTIONS[name]
    given, own = problems()[:3], per_pair(options)[:3]
    expected = singles(given, own)
    mixed = [given[0], *hopeless()[:2], given[1], hopeless()[2], given[2]]
    found = run(mixed, [own[0], options, options, own[1], options, own[2]])
    assert all(same_bits(tuple(found[b]), tuple(one)) for b, one in zip((0, 3, 5), expected, strict=True))
    assert found[1].failure.text.startswith("no hypothesis left")
    assert found[2].failure.text.startswith("too few matches: 2")
    assert found[4].failure.text == "points that are not finite"
    assert all(len(found[b].support) == 0 and not found[b].inliers.numel() for b in (1, 2, 4))


@pytest.mark.parametrize("name", OPTIONS)
def test_the_number_of_threads_does_not_show(name):
    options = OPTIONS[name]
    given, own = problems(), per_pair(options)
    found = []
    for number in THREADS:
        with threads(number):
            found.append(tuple(map(tuple, run(given, own))))
    assert all(same_bits(one, found[0]) for one in found)


def test_groups_hold_every_pair_once_and_fit(monkeypatch):
    gather, groups = module.gather_points, []

    def recorded(source, target, matches, members, *rest):
        groups.append(members)
        return gather(source, target, matches, members, *rest)

    monkeypatch.setattr(module, "gather_points", recorded)
    monkeypatch.setattr(module, "_GROUP_MATCHES", 700)
    run(problems(), [OPTIONS["compatibility"]] * 7)
    order = sorted(range(7), key=COUNTS.__getitem__)
    assert [b for group in groups for b in group] == order
    assert all(len(group) == 1 or len(group) * COUNTS[group[-1]] <= 700 for group in groups)
    assert len(groups) == 4


def test_pairs_may_have_solvers_of_their_own():
    given = problems()
    mixed = [OPTIONS["ransac"] if b % 2 else OPTIONS["compatibility"] for b in range(7)]
    assert same_bits(tuple(map(tuple, run(given, mixed))), tuple(map(tuple, singles(given, mixed))))


def test_rows_outside_a_pair_are_refused_by_name():
    source, target, matches = pack_problems(problems()[:2])
    rows = matches.source.clone()
    rows[-1] = 0  # a row of the first pair
    wrong = replace(matches, source=rows)
    with pytest.raises(ValueError, match=r"matches\.source: expected rows from 300 to 340 in this pair"):
        poses_of_pairs(source, target, wrong, [tr.CompatibilityOptions()] * 2)
