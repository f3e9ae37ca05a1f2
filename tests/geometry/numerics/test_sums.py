"""Sums of rows have the bits of ``stable_sum``, whatever stands beside or behind them."""

import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given
from hypothesis import strategies as st

from torchreg.geometry.numerics.chunks import stable_sum
from torchreg.geometry.numerics.sums import padded_length, padded_row_sums, row_sums, sum_in_order


def rows(count, width):
    return torch.randn(count, width, dtype=torch.float64, generator=torch.Generator().manual_seed(width))


@pytest.mark.parametrize("width", [1, 7, 300, 1023, 1024, 1025, 5000])
@pytest.mark.parametrize("count", [1, 2, 65])
def test_a_sum_of_rows_is_the_stable_sum(width, count):
    values = rows(count, width)
    expected = stable_sum(values.t())
    for number in THREADS:
        with threads(number):
            assert same_bits(row_sums(values), expected)
            assert same_bits(row_sums(torch.nn.functional.pad(values, (0, 3000))), expected)


def test_the_sum_of_nothing_is_zero():
    assert row_sums(torch.zeros(3, 0, dtype=torch.float64)).tolist() == [0, 0, 0]


def spread_out(rows, count, seed):
    g = torch.Generator().manual_seed(seed)
    size = 10 ** (4 * torch.rand(rows, 1, generator=g, dtype=torch.float64))
    return size * torch.randn(rows, count, generator=g, dtype=torch.float64)


@given(st.integers(1, 1100) | st.integers(1100, 5000), st.integers(1, 40), st.integers(0, 2000), st.integers(0, 2**31))
def test_a_padded_row_has_the_bits_of_a_stable_sum(count, rows, longer, seed):
    values = spread_out(rows, count, seed)
    alone = torch.stack([stable_sum(row) for row in values])
    for most in (count, count + longer):
        filled = torch.zeros(rows, padded_length(most), dtype=torch.float64)
        filled[:, :count] = values
        assert torch.equal(padded_row_sums(filled), alone)
        assert torch.equal(padded_row_sums(filled[:1]), alone[:1])
        assert torch.equal(padded_row_sums(filled.t().contiguous().t()), alone)
        assert torch.equal(padded_row_sums(filled[:, None].expand(rows, 3, -1)), alone[:, None].expand(rows, 3))


def test_a_padded_row_of_nothing_adds_up_to_zero():
    assert padded_row_sums(torch.zeros(2, padded_length(0), dtype=torch.float64)).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("count", [1, 2, 7])
def test_a_sum_in_order_adds_one_after_another(count):
    values = rows(count, 12).reshape(count, 3, 4).transpose(0, 1)  # (3, count, 4)
    expected = torch.zeros(3, 4, dtype=torch.float64)
    for k in range(count):
        expected = expected + values[:, k]
    assert same_bits(sum_in_order(values), expected)
