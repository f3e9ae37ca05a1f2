"""Nearest features are exact, and what the product says about rivals is true."""

import pytest
import torch
from determinism import THREADS, pieces, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st

from torchreg.matching.mutual import candidate_pairs
from torchreg.matching.nearest import feature_nearest, row_distance, settle_ties
from torchreg.matching.product import least, product


def brute_force(query, table, count):
    difference = query.double()[:, None] - table.double()[None]
    distance, row = (difference * difference).cumsum(dim=2)[..., -1].sqrt().sort(dim=1, stable=True)
    return row[:, :count], distance[:, :count]


def crowd(rows, width, seed, spread, dtype=torch.float32):
    """Features most of which are nearly the same, as on a wall."""
    generator = torch.Generator().manual_seed(seed)
    values = torch.rand(1, width, generator=torch.Generator().manual_seed(width), dtype=torch.float64)
    values = values + spread * torch.randn(rows, width, generator=generator, dtype=torch.float64)
    values[::5] = torch.rand(len(values[::5]), width, generator=generator, dtype=torch.float64)
    return values.to(dtype)


@settings(max_examples=50)
@given(
    st.integers(0, 2**31), st.integers(1, 40), st.integers(1, 60), st.integers(1, 33), st.integers(1, 4), st.booleans()
)
def test_the_nearest_are_those_of_brute_force(seed, rows, others, width, count, wide):
    generator = torch.Generator().manual_seed(seed)
    dtype = torch.float64 if wide else torch.float32
    query = torch.randn(rows, width, generator=generator, dtype=dtype)
    table = torch.randn(others, width, generator=generator, dtype=dtype)
    found = feature_nearest(query, table, count)
    row, distance = brute_force(query, table, count)
    assert torch.equal(found.row, row)
    assert same_bits(found.distance, distance)


@pytest.mark.parametrize("spread", [0.0, 1e-7, 1e-5, 1e-3])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("count", [1, 3])
def test_a_crowd_of_nearly_equal_rows_is_told_apart(spread, dtype, count):
    query, table = crowd(150, 33, 1, spread, dtype), crowd(400, 33, 2, spread, dtype)
    found = feature_nearest(query, table, count)
    row, distance = brute_force(query, table, count)
    assert torch.equal(found.row, row)
    assert same_bits(found.distance, distance)


@pytest.mark.parametrize("spread", [0.0, 1e-5, 1.0])
@pytest.mark.parametrize("loose", [1.0, 3.0])
def test_settled_rows_are_those_of_brute_force_whatever_the_bound(spread, loose):
    query, table = crowd(100, 9, 3, spread), crowd(300, 9, 4, spread)
    row, distance = brute_force(query, table, 3)
    found = settle_ties(query, table, 3, loose * distance[:, -1])
    assert torch.equal(found[0], row)
    assert same_bits(found[1], distance)


@settings(max_examples=80)
@given(st.integers(0, 2**31), st.integers(1, 40), st.integers(1, 40), st.integers(1, 3), st.sampled_from([9, 1e-6, 0]))
def test_a_pair_said_to_stand_or_to_fall_does(seed, rows, others, count, spread):
    query, table = crowd(rows, 6, seed, spread), crowd(others, 6, seed + 1, spread)
    pairs = candidate_pairs(feature_nearest(query, table, count), count)
    back = brute_force(table, query, count)[0]
    mutual = (back[pairs.target] == pairs.source[:, None]).any(dim=1)
    assert not (pairs.mutual & pairs.undecided).any()
    assert torch.equal(mutual & ~pairs.undecided, pairs.mutual)


def test_few_pairs_of_distinct_features_are_left_open():
    query = torch.rand(400, 33, generator=torch.Generator().manual_seed(7))
    pairs = candidate_pairs(feature_nearest(query, query.flip(0)), 1)
    assert pairs.mutual.all()


def test_the_error_of_the_product_is_within_its_bound():
    query, table = crowd(200, 33, 5, 1e-4), 3 + crowd(300, 33, 6, 1e-4)
    for center in (torch.zeros(33).double(), table.double().mean(dim=0)):
        factors = product(query, table, center, torch.float32)
        entries = (factors.left @ factors.right)[:, :300].double()
        distance = brute_force(query, table, 300)
        distance = distance[1].gather(1, distance[0].argsort(dim=1)) / factors.scale
        error = (entries - distance.square()).abs()
        assert (error <= factors.error(factors.left_norm[:, None], distance)).all()
        assert (error <= factors.error(factors.right_norm[None], distance)).all()
        longest = factors.right_norm.amax()
        assert (factors.reach(factors.left_norm[:, None], entries, longest) >= distance).all()


@pytest.mark.parametrize(
    ("columns", "width", "count"), [(64, 64, 1), (64, 64, 16), (192, 64, 5), (640, 128, 4), (640, 64, 3)]
)
def test_the_least_entries_of_a_tile_are_those_of_a_sort(columns, width, count):
    tile = torch.randint(20, (9, columns), generator=torch.Generator().manual_seed(columns)).float()
    before = tile.clone()
    value, column = least(tile, width, count)
    assert torch.equal(tile, before)
    assert torch.equal(value, tile.sort(dim=1).values[:, :count])
    assert torch.equal(tile.gather(1, column), value)
    assert all(len(row.unique()) == count for row in column)


@pytest.mark.parametrize("rows", [1, 3, 63, 64, 65, 1000, 1100, 5000, 8100])
def test_columns_make_groups_of_one_width_and_padding_is_never_near(rows):
    table = torch.rand(rows, 5, generator=torch.Generator().manual_seed(rows))
    factors = product(table[:7], table, table.double().mean(dim=0), torch.float32)
    columns = factors.right.shape[1]
    assert columns % factors.width == 0
    assert rows <= columns < rows + factors.width
    tile = factors.left @ factors.right
    assert torch.isinf(tile[:, rows:]).all()
    value, column = least(tile, factors.width, min(rows, 4))
    assert (column < rows).all()
    assert torch.equal(value, tile[:, :rows].sort(dim=1).values[:, : min(rows, 4)])


def test_no_more_rows_come_back_than_there_are():
    found = feature_nearest(torch.ones(3, 2), torch.zeros(1, 2), 4)
    assert found.row.tolist() == [[0], [0], [0]]


def test_a_distance_has_its_bits_whatever_stands_beside_it():
    left, right = torch.rand(2, 2000, 44, generator=torch.Generator().manual_seed(0))
    together = row_distance(left, right)
    for cut in (slice(0, 1), slice(7, 30), slice(500, 2000)):
        assert same_bits(row_distance(left[cut], right[cut]), together[cut])
    for number in THREADS:
        with threads(number):
            assert same_bits(row_distance(left, right), together)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("count", [1, 2])
def test_neither_threads_nor_tiles_change_a_bit(dtype, count):
    query, table = crowd(90, 20, 1, 1e-5, dtype), crowd(250, 20, 2, 1e-5, dtype)
    expected = feature_nearest(query, table, count)
    for number in THREADS:
        for tile in (1, 250 * 13):
            with threads(number), pieces(1 << 17, tile):
                found = feature_nearest(query, table, count)
                assert same_bits(found.row, expected.row)
                assert same_bits(found.distance, expected.distance)


def test_no_gradient_is_asked_for():
    query = torch.rand(5, 3, requires_grad=True)
    assert not feature_nearest(query, query).distance.requires_grad
