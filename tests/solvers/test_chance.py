"""The test against chance: its numbers against exact ones, right pairs accepted, chance refused."""

import math
from fractions import Fraction

import pytest
import torch
from determinism import assert_nothing_shows
from hypothesis import given
from hypothesis import strategies as st
from problems import correspondence_problem

import torchreg as tr
from torchreg.solvers.chance import chance_rate, log10_binomial_tail, log10_false_alarms, no_consensus


@given(st.integers(1, 60), st.integers(-3, 65), st.integers(1, 999))
def test_the_binomial_tail_is_exact_sums_of_fractions(trials, successes, thousandths):
    p = Fraction(thousandths, 1000)
    exact = sum(math.comb(trials, k) * p**k * (1 - p) ** (trials - k) for k in range(max(0, successes), trials + 1))
    found = log10_binomial_tail(trials, successes, float(p))
    if successes > trials:
        assert found == -math.inf
    elif successes <= 0 or p * trials >= successes:
        assert found == 0.0
    else:
        assert found == pytest.approx(math.log10(exact), abs=1e-9)


def test_a_long_tail_does_not_overflow():
    found = log10_binomial_tail(1_000_000, 5000, 1e-3)
    assert -10_000 < found < -1000
    assert log10_binomial_tail(1_000_000, 4000, 1e-3) > found


def test_the_chance_rate_is_the_share_of_close_pairs_of_different_matches():
    generator = torch.Generator().manual_seed(0)
    p, q = torch.rand(2, 60, 3, dtype=torch.float64, generator=generator)
    near = torch.cdist(p, q) < 0.3
    near.fill_diagonal_(False)
    assert chance_rate(p, q, 0.3) == pytest.approx(float(near.sum()) / (60 * 59), rel=1e-12)


def test_the_chance_rate_is_never_zero():
    p = torch.arange(4.0, dtype=torch.float64)[:, None].expand(4, 3) * 100
    assert chance_rate(p, p, 1e-3) == pytest.approx(1 / 12)
    assert 0 < chance_rate(p[:1], p[:1], 1.0) <= 1


def test_more_agreement_has_fewer_false_alarms():
    alarms = []
    for outlier_ratio in (0.95, 0.9, 0.8, 0.5):
        problem = correspondence_problem(300, outlier_ratio)
        R, t = problem.T_target_source[0, :3, :3], problem.T_target_source[0, :3, 3]
        moved = problem.source.points[problem.matches.source] @ R.t() + t
        target = problem.target.points[problem.matches.target]
        alarms.append(log10_false_alarms(moved, target, 0.2, sample_size=3, scored=1000))
    assert alarms == sorted(alarms, reverse=True)
    assert alarms[-1] < -50


def test_more_hypotheses_have_more_false_alarms():
    p, q = torch.rand(2, 100, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    few, many = (log10_false_alarms(p, q, 0.1, sample_size=3, scored=scored) for scored in (10, 1000))
    assert many == pytest.approx(few + 2)


def test_a_failure_names_the_numbers():
    assert no_consensus(50, 100, -20.0) is None
    failure = no_consensus(7, 100, -3.0)
    assert failure.kind == "no consensus"
    assert "7 of 100" in failure.text
    assert "10^-3.0" in failure.text
    assert failure.figures == {"support": 7, "matches": 100, "log10_false_alarms": -3.0}


@pytest.mark.parametrize("seed", range(20))
def test_matches_by_chance_are_no_success(seed):
    problem = correspondence_problem(50 + 20 * seed, 1.0, seed=seed)
    result = tr.ransac(problem.source, problem.target, problem.matches, tr.RansacOptions(hypotheses=100_000))
    assert result.success.tolist() == [False]
    assert result.reason[0].startswith("no consensus")


def test_the_verdict_does_not_depend_on_threads_or_pieces():
    p, q = torch.rand(2, 2500, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    assert_nothing_shows(lambda: log10_false_alarms(p, q, 0.1, sample_size=3, scored=500))
