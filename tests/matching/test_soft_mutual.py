"""Matches among several nearest neighbors, against brute force in float64."""

import pytest
import torch
from determinism import assert_nothing_shows, same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import features
from refusals import refuses

import torchreg as tr
from torchreg.types.packing import spans


def soft_matches(source, target, neighbors):
    """(source row, target row) of all pairs that are among each other's nearest, ties to the lower row."""
    found = []
    for (begin, end), (first, last) in zip(spans(source.offsets), spans(target.offsets), strict=True):
        left = [i for i in range(begin, end) if bool(source.valid[i])]
        right = [k for k in range(first, last) if bool(target.valid[k])]
        difference = source.values[left].double()[:, None] - target.values[right].double()[None]
        distance = (difference * difference).sum(dim=2).sqrt()  # (N, M)
        forth = distance.argsort(dim=1, stable=True)[:, :neighbors].tolist()
        back = distance.argsort(dim=0, stable=True)[:neighbors].t().tolist()
        found += [(left[i], right[k]) for i, row in enumerate(forth) for k in sorted(row) if i in back[k]]
    return found


def whole_numbers(rows, width, levels, seed, dtype=torch.float32):
    """Features many of which are equal, at distances many of which tie exactly."""
    return torch.randint(levels + 1, (rows, width), generator=torch.Generator().manual_seed(seed)).to(dtype)


def wall(rows, seed, spread=1e-5):
    """Features most of which differ by little, some by nothing."""
    generator = torch.Generator().manual_seed(seed)
    values = torch.full((rows, 33), 0.2) + spread * torch.randn(rows, 33, generator=generator)
    values[::4] = torch.rand(len(values[::4]), 33, generator=generator)
    values[1::7] = values[1:2].clone()
    return values


def found(matches):
    return list(zip(matches.source.tolist(), matches.target.tolist(), strict=True))


@settings(max_examples=120)
@given(
    st.integers(0, 2**31), st.integers(0, 25), st.integers(0, 25), st.integers(1, 4), st.integers(1, 3),
    st.integers(1, 4), st.booleans(),
)  # fmt: skip
def test_matches_among_ties_are_those_of_brute_force(seed, rows, others, width, levels, neighbors, wide):
    dtype = torch.float64 if wide else torch.float32
    source = features(whole_numbers(rows, width, levels, seed, dtype))
    target = features(whole_numbers(others, width, levels, seed + 1, dtype))
    assert found(tr.match_mutual(source, target, neighbors=neighbors)) == soft_matches(source, target, neighbors)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 90), st.integers(1, 90), st.integers(1, 3), st.sampled_from([1e-7, 1e-5]))
def test_matches_on_a_wall_are_those_of_brute_force(seed, rows, others, neighbors, spread):
    source, target = features(wall(rows, seed, spread)), features(wall(others, seed + 1, spread))
    matches = tr.match_mutual(source, target, neighbors=neighbors)
    assert found(matches) == soft_matches(source, target, neighbors)
    distance = (source.values[matches.source].double() - target.values[matches.target].double()).norm(dim=1)
    assert torch.allclose(matches.score.double(), distance, rtol=1e-6, atol=0)


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.integers(1, 40), st.integers(1, 40))
def test_more_neighbors_only_add_matches(seed, rows, others):
    source, target = features(wall(rows, seed)), features(wall(others, seed + 1))
    fewer = set()
    for neighbors in (1, 2, 3, 40):
        more = set(found(tr.match_mutual(source, target, neighbors=neighbors)))
        assert fewer <= more
        fewer = more
    assert len(fewer) == rows * others  # with as many neighbors as rows, everything is mutual


@pytest.mark.parametrize("neighbors", [1, 2, 3])
def test_swapped_sides_give_the_swapped_matches(neighbors):
    source, target = features(wall(300, 1)), features(wall(200, 2))
    forth = tr.match_mutual(source, target, neighbors=neighbors)
    back = tr.match_mutual(target, source, neighbors=neighbors)
    assert sorted((s, t) for t, s in found(back)) == found(forth)
    assert same_bits(back.score[torch.argsort(back.target * 200 + back.source)], forth.score)


def test_one_neighbor_is_the_default():
    source, target = features(wall(300, 1)), features(wall(200, 2))
    assert same_bits(tr.match_mutual(source, target, neighbors=1), tr.match_mutual(source, target))


def test_a_point_has_at_most_as_many_matches_as_neighbors():
    matches = tr.match_mutual(features(wall(300, 1)), features(wall(200, 2)), neighbors=3)
    assert matches.source.bincount().amax() == matches.target.bincount().amax() == 3


def test_a_batch_equals_the_loop_over_its_pairs():
    lengths, others = [40, 0, 1, 100, 7], [30, 10, 1, 90, 200]
    pairs = [(wall(n, b), wall(m, b + 50)) for b, (n, m) in enumerate(zip(lengths, others, strict=True))]
    source = features(torch.cat([left for left, _ in pairs]), lengths)
    target = features(torch.cat([right for _, right in pairs]), others)
    together = tr.match_mutual(source, target, neighbors=2)
    for b, (left, right) in enumerate(pairs):
        begin, end = together.offsets[b : b + 2].tolist()
        alone = tr.match_mutual(features(left), features(right), neighbors=2)
        assert torch.equal(together.source[begin:end] - source.offsets[b], alone.source)
        assert torch.equal(together.target[begin:end] - target.offsets[b], alone.target)
        assert same_bits(together.score[begin:end], alone.score)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 3))
def test_rows_that_are_not_valid_are_never_matched(seed, neighbors):
    generator = torch.Generator().manual_seed(seed)
    masks = [torch.rand(40, generator=generator) < 0.6 for _ in range(2)]
    values = [whole_numbers(40, 3, 2, seed + side) for side in range(2)]
    source, target = (features(value, valid=mask) for value, mask in zip(values, masks, strict=True))
    matches = tr.match_mutual(source, target, neighbors=neighbors)
    assert masks[0][matches.source].all()
    assert masks[1][matches.target].all()
    assert found(matches) == soft_matches(source, target, neighbors)
    spoiled = [torch.where(mask[:, None], value, float("nan")) for value, mask in zip(values, masks, strict=True)]
    source, target = (features(value, valid=mask) for value, mask in zip(spoiled, masks, strict=True))
    assert same_bits(tr.match_mutual(source, target, neighbors=neighbors), matches)


def test_of_equal_features_the_first_ones_match():
    source, target = features(torch.ones(50, 9)), features(torch.ones(70, 9))
    matches = tr.match_mutual(source, target, neighbors=3)
    assert found(matches) == [(i, k) for i in range(3) for k in range(3)]


@pytest.mark.parametrize("scale", [1e-25, 1e25])
def test_features_whose_squares_leave_the_range_of_float32_are_matched(scale):
    source, target = features(scale * wall(60, 1, 1e-2)), features(scale * wall(80, 2, 1e-2))
    assert found(tr.match_mutual(source, target, neighbors=2)) == soft_matches(source, target, 2)


def test_neither_threads_nor_tiles_change_a_bit():
    source, target = features(wall(400, 1)), features(wall(300, 2))
    assert_nothing_shows(lambda: tr.match_mutual(source, target, neighbors=2))


@pytest.mark.parametrize("neighbors", [0, -1, 1.5, True])
def test_a_number_of_neighbors_that_is_none_is_refused(neighbors):
    one = features(torch.rand(4, 3))
    with refuses("neighbors", "an integer", repr(neighbors)):
        tr.match_mutual(one, one, neighbors=neighbors)


def test_a_ratio_beside_several_neighbors_is_refused():
    one = features(torch.rand(4, 3))
    with refuses("neighbors", "1 beside a ratio", "2"):
        tr.match_mutual(one, one, ratio=0.9, neighbors=2)
