"""Draws follow from the seed and the pair, from nothing else."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchreg.ransac.sampling import ROUND, base_seed, pair_seed, sample_rounds

CPU = torch.device("cpu")


@given(st.integers(1, 50), st.integers(3, 5), st.integers(1, 5000), st.integers(0, 2**60))
def test_exactly_so_many_samples_in_range(count, size, total, seed):
    samples = torch.cat(list(sample_rounds(count, size, total, seed, CPU)))
    assert samples.shape == (total, size)
    assert samples.min() >= 0
    assert samples.max() < count


def test_a_smaller_total_draws_the_same_first_rounds():
    many = torch.cat(list(sample_rounds(100, 3, 3 * ROUND, 7, CPU)))
    few = torch.cat(list(sample_rounds(100, 3, ROUND, 7, CPU)))
    assert torch.equal(many[:ROUND], few)
    assert not torch.equal(many[ROUND : 2 * ROUND], few)


def test_every_correspondence_is_as_likely():
    samples = torch.cat(list(sample_rounds(10, 3, 20_000, 1, CPU)))
    counts = torch.bincount(samples.flatten(), minlength=10)
    assert (counts - 6000).abs().max() < 6 * 6000**0.5


def test_a_generator_gives_a_seed_and_moves_on():
    one, other = (torch.Generator().manual_seed(5) for _ in range(2))
    assert base_seed(one) == base_seed(other)
    assert base_seed(one) != base_seed(torch.Generator().manual_seed(5))
    assert base_seed(None) == base_seed(None)


def test_the_global_generator_is_left_alone():
    before = torch.get_rng_state()
    base_seed(None)
    base_seed(torch.Generator().manual_seed(1))
    list(sample_rounds(5, 3, 10, 2, CPU))
    assert torch.equal(torch.get_rng_state(), before)


def test_seeds_differ_between_pairs_and_calls():
    rows = torch.arange(20)
    seeds = [
        pair_seed(0, rows, rows),
        pair_seed(1, rows, rows),
        pair_seed(0, rows, rows.flip(0)),
        pair_seed(0, rows.flip(0), rows),
        pair_seed(0, rows.flip(0), rows.flip(0)),
        pair_seed(0, rows[:19], rows[:19]),
        pair_seed(0, rows + 1, rows),
        pair_seed(0, rows, rows + 1),
        pair_seed(0, rows[:0], rows[:0]),
    ]
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_a_pair_seed_is_for_matches_of_one_length():
    with pytest.raises(ValueError, match="target: expected"):
        pair_seed(0, torch.arange(3), torch.arange(4))
