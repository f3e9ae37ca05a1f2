"""Mutual matches against brute force in float64, exact ties and duplicates included."""

import oracles
import pytest
import torch
from determinism import assert_nothing_shows, same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import features
from refusals import refuses

import torchreg as tr


def random_values(rows, width=8, seed=0, dtype=torch.float32):
    return torch.randn(rows, width, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def noisy_pair(rows, others, width=33, seed=0, noise=0.3, dtype=torch.float32):
    """Features of two scans: a part of the one comes back in the other with noise."""
    source = random_values(rows, width, seed, torch.float64)
    target = random_values(others, width, seed + 1000, torch.float64)
    shared = min(rows, others) // 2
    target[:shared] = source[:shared] + noise * random_values(shared, width, seed + 2000, torch.float64)
    return features(source.to(dtype)), features(target.to(dtype))


def found(matches):
    return list(zip(matches.source.tolist(), matches.target.tolist(), strict=True))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("ratio", [None, 0.9, 1.0])
def test_matches_are_those_of_brute_force(dtype, ratio):
    source, target = noisy_pair(300, 200, dtype=dtype)
    matches = tr.match_mutual(source, target, ratio=ratio)
    assert found(matches) == oracles.mutual_matches(source, target, ratio)
    assert len(matches.source) > 50
    assert matches.score.dtype == dtype
    distance = (source.values[matches.source].double() - target.values[matches.target].double()).norm(dim=1)
    assert torch.allclose(matches.score.double(), distance, rtol=1e-6)


@settings(max_examples=80)
@given(
    st.integers(0, 2**31), st.integers(0, 25), st.integers(0, 25), st.integers(1, 4), st.integers(1, 3), st.booleans()
)
def test_ties_go_to_the_lower_row(seed, rows, others, width, levels, wide):
    # whole numbers: many features are equal, many distances tie exactly
    generator = torch.Generator().manual_seed(seed)
    dtype = torch.float64 if wide else torch.float32
    source = torch.randint(levels + 1, (rows, width), generator=generator).to(dtype)
    target = torch.randint(levels + 1, (others, width), generator=generator).to(dtype)
    pair = features(source), features(target)
    assert found(tr.match_mutual(*pair)) == oracles.mutual_matches(*pair)


@settings(max_examples=80)
@given(st.integers(0, 2**31), st.integers(1, 25), st.integers(2, 25), st.booleans())
def test_the_ratio_test_is_exact_among_ties_and_duplicates(seed, rows, others, wide):
    generator = torch.Generator().manual_seed(seed)
    dtype = torch.float64 if wide else torch.float32
    codebook = torch.rand(6, 33, generator=generator, dtype=torch.float64).to(dtype)
    source = features(codebook[torch.randint(6, (rows,), generator=generator)])
    target = features(codebook[torch.randint(6, (others,), generator=generator)])
    for ratio in (0.8, 1.0):
        assert found(tr.match_mutual(source, target, ratio=ratio)) == oracles.mutual_matches(source, target, ratio)


def test_a_second_nearest_at_the_same_distance_fails_every_ratio():
    source = features(torch.tensor([[0.0, 0]]))
    target = features(torch.tensor([[3.0, 4], [4, 3], [50, 0]]))
    assert found(tr.match_mutual(source, target)) == [(0, 0)]
    assert found(tr.match_mutual(source, target, ratio=1.0)) == []


def test_a_single_target_passes_every_ratio():
    source, target = features(torch.tensor([[0.0], [5]])), features(torch.tensor([[1.0]]))
    assert found(tr.match_mutual(source, target, ratio=0.1)) == [(0, 0)]


@pytest.mark.parametrize("ratio", [0.5, 0.7, 0.95])
def test_a_lower_ratio_keeps_a_part(ratio):
    source, target = noisy_pair(300, 300)
    everything = set(found(tr.match_mutual(source, target)))
    kept = set(found(tr.match_mutual(source, target, ratio=ratio)))
    assert kept < everything


def test_many_equal_features_match_the_first_of_each():
    values = random_values(7, 33).repeat(60, 1)
    matches = tr.match_mutual(features(values), features(values.flip(0)))
    assert found(matches) == [(row, 6 - row) for row in range(7)]


def test_close_features_far_from_zero_are_told_apart():
    # |b|^2 - 2 a.b loses these differences in float32; the elementwise distance does not
    base = 1000 + random_values(1, 33, 1)
    steps = 1e-2 * random_values(40, 33, 2)
    source, target = features(base + steps), features((base + steps).flip(0))
    assert found(tr.match_mutual(source, target)) == [(row, 39 - row) for row in range(40)]


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_the_scale_of_features_does_not_matter(scale):
    source, target = noisy_pair(100, 100, dtype=torch.float64)
    scaled = (features(source.values * scale), features(target.values * scale))
    assert found(tr.match_mutual(*scaled)) == found(tr.match_mutual(source, target))


def test_swapped_sides_give_the_same_matches():
    source, target = noisy_pair(200, 150)
    forth, back = tr.match_mutual(source, target), tr.match_mutual(target, source)
    assert sorted(found(forth)) == sorted((s, t) for t, s in found(back))


def test_every_row_is_matched_at_most_once_and_sources_ascend():
    matches = tr.match_mutual(*noisy_pair(300, 200))
    assert (matches.source.diff() > 0).all()
    assert len(matches.target.unique()) == len(matches.target)


def test_an_identical_cloud_matches_itself():
    values = random_values(500, 44)
    matches = tr.match_mutual(features(values), features(values))
    assert matches.source.tolist() == matches.target.tolist() == list(range(500))
    assert not matches.score.any()


@settings(max_examples=30)
@given(st.integers(0, 2**31))
def test_rows_that_are_not_valid_are_never_matched(seed):
    generator = torch.Generator().manual_seed(seed)
    source, target = noisy_pair(40, 40, seed=seed)
    masks = [torch.rand(40, generator=generator) < 0.6 for _ in range(2)]
    masked = [features(one.values, valid=mask) for one, mask in zip((source, target), masks, strict=True)]
    matches = tr.match_mutual(*masked)
    assert masks[0][matches.source].all()
    assert masks[1][matches.target].all()
    assert found(matches) == oracles.mutual_matches(*masked)


def test_values_of_rows_that_are_not_valid_may_be_anything():
    source, target = noisy_pair(50, 50)
    valid = torch.arange(50) % 3 != 0
    expected = found(tr.match_mutual(features(source.values, valid=valid), features(target.values, valid=valid)))
    for bad in (float("nan"), float("inf"), 1e30):
        spoiled = [torch.where(valid[:, None], side.values, bad) for side in (source, target)]
        assert found(tr.match_mutual(*(features(values, valid=valid) for values in spoiled))) == expected


@pytest.mark.parametrize(("rows", "others"), [(0, 5), (5, 0), (0, 0)])
def test_an_empty_side_has_no_matches(rows, others):
    matches = tr.match_mutual(features(random_values(rows)), features(random_values(others)))
    assert found(matches) == []
    assert matches.offsets.tolist() == [0, 0]


def test_a_side_without_valid_rows_has_no_matches():
    none = torch.zeros(5, dtype=torch.bool)
    assert found(tr.match_mutual(features(random_values(5), valid=none), features(random_values(5)))) == []


def test_a_batch_equals_the_loop_over_its_pairs():
    lengths, others = [40, 0, 1, 100, 30, 7], [30, 10, 1, 90, 0, 200]
    pairs = [noisy_pair(n, m, seed=b) for b, (n, m) in enumerate(zip(lengths, others, strict=True))]
    for order in (list(range(6)), [3, 5, 1, 0, 4, 2]):
        source = features(torch.cat([pairs[b][0].values for b in order]), [lengths[b] for b in order])
        target = features(torch.cat([pairs[b][1].values for b in order]), [others[b] for b in order])
        together = tr.match_mutual(source, target, ratio=0.98)
        for place, b in enumerate(order):
            begin, end = together.offsets[place : place + 2].tolist()
            alone = tr.match_mutual(*pairs[b], ratio=0.98)
            assert torch.equal(together.source[begin:end] - source.offsets[place], alone.source)
            assert torch.equal(together.target[begin:end] - target.offsets[place], alone.target)
            assert same_bits(together.score[begin:end], alone.score)


@pytest.mark.parametrize("options", [{}, {"neighbors": 2}, {"ratio": 0.95}])
def test_hopeless_pairs_in_between_change_nothing(options):
    pairs = [noisy_pair(n, m, seed=n) for n, m in ((1100, 900), (70, 3), (400, 1500))]
    nothing, equal = random_values(0, 33), random_values(1, 33).repeat(200, 1)
    mixed = [pairs[0], (features(nothing), pairs[1][1]), pairs[1], (features(equal), features(equal)), pairs[2]]
    sides = [
        features(torch.cat([pair[side].values for pair in mixed]), [len(pair[side].values) for pair in mixed])
        for side in (0, 1)
    ]
    together = tr.match_mutual(*sides, **options)
    for place, pair in ((0, pairs[0]), (2, pairs[1]), (4, pairs[2])):
        begin, end = together.offsets[place : place + 2].tolist()
        alone = tr.match_mutual(*pair, **options)
        assert torch.equal(together.source[begin:end] - sides[0].offsets[place], alone.source)
        assert torch.equal(together.target[begin:end] - sides[1].offsets[place], alone.target)
        assert same_bits(together.score[begin:end], alone.score)
    assert together.offsets[1] == together.offsets[2]


@pytest.mark.parametrize("ratio", [None, 0.9])
def test_neither_threads_nor_tiles_change_a_bit(ratio):
    source, target = noisy_pair(900, 700, noise=0.5)
    assert_nothing_shows(lambda: tr.match_mutual(source, target, ratio=ratio))


def test_neither_threads_nor_tiles_change_a_bit_of_near_ties():
    base = random_values(20, 33)
    close = (base.repeat(18, 1) + 1e-6 * random_values(360, 33, 5)).contiguous()
    source, target = features(close), features(close.flip(0) + 1e-6 * random_values(360, 33, 6))
    assert found(tr.match_mutual(source, target)) == oracles.mutual_matches(source, target)
    assert_nothing_shows(lambda: tr.match_mutual(source, target))
    assert_nothing_shows(lambda: tr.match_mutual(source, target, ratio=0.999))


def test_a_match_is_not_lost_where_the_product_proposes_a_target_that_another_source_is_nearer_to():
    # every query lies between two targets, as far from one as from the other within the rounding of a product in
    # float32; close to the first of the two sits another source, so that only the second can be the query's match
    count, width = 300, 33
    query = 10 * random_values(count, width, 1, torch.float64)
    step = torch.nn.functional.normalize(random_values(count, width, 2, torch.float64), dim=1)
    shorter = 1 - 1e-5 * torch.rand(count, 1, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    first, second = query + step, query - shorter * step
    taken = first + 0.01 * random_values(count, width, 4, torch.float64)
    source = features(torch.cat([query, taken]).float())
    target = features(torch.cat([first, second]).float())
    expected = oracles.mutual_matches(source, target)
    assert sum(k >= count for _, k in expected) > 250
    assert found(tr.match_mutual(source, target)) == expected
    assert found(tr.match_mutual(target, source)) == sorted((k, i) for i, k in expected)


def test_what_does_not_fit_is_refused():
    one = features(random_values(4))
    with refuses("target", "1 clouds", "2"):
        tr.match_mutual(one, features(random_values(4), [2, 2]))
    with refuses("target", "width 8", "(4, 9)"):
        tr.match_mutual(one, features(random_values(4, 9)))
    with refuses("target", "float32", "float64"):
        tr.match_mutual(one, features(random_values(4, dtype=torch.float64)))


@pytest.mark.parametrize("ratio", [0.0, -1.0, 1.1, float("nan")])
def test_a_ratio_out_of_range_is_refused(ratio):
    one = features(random_values(4))
    with refuses("ratio", "(0, 1]", repr(ratio)):
        tr.match_mutual(one, one, ratio=ratio)
