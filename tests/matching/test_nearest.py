"""Nearest features are exact, and the second distance is what a ratio test needs."""

import pytest
import torch
from closeness import close
from determinism import THREADS, pieces, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st

from torchreg.matching.nearest import feature_nearest
from torchreg.matching.settle import row_distance


def brute_force(query, table):
    difference = query.double()[:, None] - table.double()[None]
    distance = (difference * difference).sum(dim=2).sqrt()
    nearest, second = distance.sort(dim=1, stable=True).values[:, :2].unbind(1)
    return distance.numpy().argmin(axis=1).tolist(), nearest, second


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.integers(1, 40), st.integers(2, 40), st.integers(1, 33), st.booleans())
def test_nearest_and_second_are_those_of_brute_force(seed, rows, others, width, wide):
    generator = torch.Generator().manual_seed(seed)
    dtype = torch.float64 if wide else torch.float32
    query = torch.randn(rows, width, generator=generator, dtype=dtype)
    table = torch.randn(others, width, generator=generator, dtype=dtype)
    found = feature_nearest(query, table)
    row, nearest, second = brute_force(query, table)
    assert found.row.tolist() == row
    assert torch.allclose(found.distance, nearest, rtol=1e-13, atol=1e-15)
    # the second is read off the product, whose rounding grows under the root where the distance is small
    assert close(found.second.square(), second.square(), atol=1e-11 if wide else 1e-3)


def test_one_row_alone_has_no_second():
    found = feature_nearest(torch.ones(3, 2), torch.zeros(1, 2))
    assert found.row.tolist() == [0, 0, 0]
    assert torch.isinf(found.second).all()


def test_a_distance_has_its_bits_whatever_stands_beside_it():
    left, right = torch.rand(2, 2000, 44, generator=torch.Generator().manual_seed(0))
    together = row_distance(left, right)
    for cut in (slice(0, 1), slice(7, 30), slice(500, 2000)):
        assert same_bits(row_distance(left[cut], right[cut]), together[cut])
    for number in THREADS:
        with threads(number):
            assert same_bits(row_distance(left, right), together)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_neither_threads_nor_tiles_change_a_bit(dtype):
    query, table = torch.rand(2, 900, 44, generator=torch.Generator().manual_seed(1), dtype=dtype)
    expected = feature_nearest(query, table)
    for number in THREADS:
        for tile in (1, 900 * 13, 1 << 30):
            with threads(number), pieces(1 << 17, tile):
                found = feature_nearest(query, table)
                assert same_bits(found.row, expected.row)
                assert same_bits(found.distance, expected.distance)


def test_no_gradient_is_asked_for():
    query = torch.rand(5, 3, requires_grad=True)
    assert not feature_nearest(query, query).distance.requires_grad
