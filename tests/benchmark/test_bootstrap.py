"""The bootstrap: how often its interval holds the truth, and that nothing but its arguments decides."""

import numpy as np
import pytest
import torch
from refusals import refuses

from torchreg.benchmark.core.bootstrap import bootstrap, bootstrap_of_groups, mean, median


def normal(count, seed):
    return torch.randn(count, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)).tolist()


@pytest.mark.parametrize(("statistic", "level"), [(mean, 0.95), (mean, 0.5), (median, 0.9)])
def test_the_interval_holds_the_truth_about_as_often_as_it_says(statistic, level):
    runs = 300
    held = 0
    for seed in range(runs):
        found = bootstrap(normal(60, seed), statistic, level=level, resamples=400, seed=seed)
        held += found.low <= 0 <= found.high
    assert held / runs == pytest.approx(level, abs=0.07)


def test_the_interval_of_a_mean_is_the_textbook_one():
    values = normal(2000, 3)
    found = bootstrap(values)
    half = 1.96 * np.std(values) / len(values) ** 0.5
    assert found.value == pytest.approx(np.mean(values))
    assert found.high - found.low == pytest.approx(2 * half, rel=0.05)


def test_a_rate_stays_within_zero_and_one():
    found = bootstrap([1.0] * 9 + [0.0])
    assert found.value == pytest.approx(0.9)
    assert 0 < found.low < 0.9 <= found.high <= 1


def test_the_median_is_numpys():
    for count in (1, 2, 5, 8):
        values = normal(count, count)
        assert float(median(torch.tensor(values))) == pytest.approx(np.median(values))


def test_the_same_seed_the_same_bits():
    values = normal(20, 0)
    state = torch.random.get_rng_state()
    assert bootstrap(values, seed=1) == bootstrap(values, seed=1)
    assert bootstrap(values, seed=1) != bootstrap(values, seed=2)
    assert torch.equal(torch.random.get_rng_state(), state)


def test_groups_of_one_are_pairs():
    values = normal(25, 1)
    assert bootstrap_of_groups(values, range(25), seed=2) == pytest.approx(bootstrap(values, seed=2))


def test_pairs_of_a_group_count_as_the_group():
    """Every pair told four times: the interval over groups stays as wide, that over pairs halves."""
    values = normal(30, 2)
    often, groups = values * 4, list(range(30)) * 4
    once, repeated = bootstrap(values), bootstrap_of_groups(often, groups)
    assert (repeated.value, repeated.low, repeated.high) == pytest.approx(once)
    plain = bootstrap(often)
    assert plain.high - plain.low == pytest.approx((once.high - once.low) / 2, rel=0.05)


def test_large_groups_weigh_as_many_pairs():
    found = bootstrap_of_groups([1.0, 1.0, 1.0, 0.0], "aaab")
    assert (found.value, found.low, found.high) == (0.75, 0.0, 1.0)


def test_refused():
    with refuses("groups", "one per value"):
        bootstrap_of_groups([1.0, 2.0], ["a"])
    with refuses("values", "at least one"):
        bootstrap([])
    with refuses("level", "below 1"):
        bootstrap([1.0], level=1.0)
    with refuses("resamples"):
        bootstrap([1.0], resamples=0)
