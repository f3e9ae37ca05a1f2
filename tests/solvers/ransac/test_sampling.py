"""Draws follow from the seed and the pair, from nothing else."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from torchreg.solvers.ransac.sampling import FIRST_ROUND, sample_rounds

CPU = torch.device("cpu")


@given(st.integers(1, 50), st.integers(3, 5), st.integers(1, 5000), st.integers(0, 2**60))
def test_exactly_so_many_samples_in_range(count, size, total, seed):
    samples = torch.cat(list(sample_rounds(count, size, total, seed, CPU)))
    assert samples.shape == (total, size)
    assert samples.min() >= 0
    assert samples.max() < count


def test_a_smaller_total_draws_the_same_first_rounds():
    rounds = list(sample_rounds(100, 3, 200_000, 7, CPU))
    few = torch.cat(list(sample_rounds(100, 3, 3 * FIRST_ROUND, 7, CPU)))
    assert torch.equal(torch.cat(rounds[:2]), few)
    assert not torch.equal(rounds[1][:FIRST_ROUND], rounds[0])
    assert [len(drawn) for drawn in rounds[:6]] == [1 << 12, 1 << 13, 1 << 14, 1 << 15, 1 << 15, 1 << 15]


def test_every_correspondence_is_as_likely():
    samples = torch.cat(list(sample_rounds(10, 3, 20_000, 1, CPU)))
    counts = torch.bincount(samples.flatten(), minlength=10)
    assert (counts - 6000).abs().max() < 6 * 6000**0.5


def test_the_global_generator_is_left_alone():
    before = torch.get_rng_state()
    list(sample_rounds(5, 3, 10, 2, CPU))
    assert torch.equal(torch.get_rng_state(), before)
