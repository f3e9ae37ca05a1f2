"""Simulated pairs to train on: groups, seeds, overlap."""

import pytest
from determinism import same_bits
from refusals import refuses

import torchreg as tr
from torchreg.datasets.training_places import GROUPS, simulated_pairs


@pytest.mark.slow
def test_a_place_of_each_kind_a_seed_and_the_same_bits_again():
    pairs = list(simulated_pairs(3, 1))
    assert tuple(dict.fromkeys(pair.group for pair in pairs)) == GROUPS
    assert len({pair.pair.name for pair in pairs}) == len(pairs) >= 3
    for posed in pairs:
        thin = posed.thinned().pair
        T = thin.T_target_source[None]
        assert float(tr.metrics.overlap(thin.source, thin.target, T, 2 * posed.voxel)) > 0.2, posed.pair.name
    again = list(simulated_pairs(3, 1))
    assert all(same_bits(one.pair, two.pair) for one, two in zip(pairs, again, strict=True))
    other = next(simulated_pairs(4, 1))
    assert other.pair.name != pairs[0].pair.name


def test_what_does_not_fit_is_refused():
    with refuses("first", "-1"):
        next(simulated_pairs(-1, 1))
    assert list(simulated_pairs(0, 0)) == []
