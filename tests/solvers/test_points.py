"""Seeds follow from the call and the pair, from nothing else."""

import pytest
import torch

from torchreg.solvers.points import base_seed, pair_seeds


def test_a_generator_gives_a_seed_and_moves_on():
    one, other = (torch.Generator().manual_seed(5) for _ in range(2))
    assert base_seed(one) == base_seed(other)
    assert base_seed(one) != base_seed(torch.Generator().manual_seed(5))
    assert base_seed(None) == base_seed(None)


def test_seeds_differ_between_pairs_and_calls():
    rows = torch.arange(20)
    seeds = [
        *pair_seeds(0, rows, rows, [20]),
        *pair_seeds(1, rows, rows, [20]),
        *pair_seeds(0, rows, rows.flip(0), [20]),
        *pair_seeds(0, rows.flip(0), rows, [20]),
        *pair_seeds(0, rows.flip(0), rows.flip(0), [20]),
        *pair_seeds(0, rows[:19], rows[:19], [19]),
        *pair_seeds(0, rows + 1, rows, [20]),
        *pair_seeds(0, rows, rows + 1, [20]),
        *pair_seeds(0, rows[:0], rows[:0], [0]),
    ]
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_a_pair_seed_is_for_matches_of_one_length():
    with pytest.raises(ValueError, match="target: expected"):
        pair_seeds(0, torch.arange(3), torch.arange(4), [3])
