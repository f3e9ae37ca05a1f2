"""Sums of filled-up rows have the bits of ``stable_sum``, whatever stands beside them."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from torchreg.geometry.numerics.chunks import stable_sum
from torchreg.verification.sums import padded, row_sums


def numbers(rows, count, seed):
    g = torch.Generator().manual_seed(seed)
    size = 10 ** (4 * torch.rand(rows, 1, generator=g, dtype=torch.float64))
    return size * torch.randn(rows, count, generator=g, dtype=torch.float64)


@given(st.integers(1, 1100) | st.integers(1100, 5000), st.integers(1, 40), st.integers(0, 2000), st.integers(0, 2**31))
def test_a_row_has_the_bits_of_a_stable_sum(count, rows, longer, seed):
    values = numbers(rows, count, seed)
    alone = torch.stack([stable_sum(row) for row in values])
    for most in (count, count + longer):
        filled = torch.zeros(rows, padded(most), dtype=torch.float64)
        filled[:, :count] = values
        assert torch.equal(row_sums(filled), alone)
        assert torch.equal(row_sums(filled[:1]), alone[:1])
        assert torch.equal(row_sums(filled.t().contiguous().t()), alone)
        assert torch.equal(row_sums(filled[:, None].expand(rows, 3, -1)), alone[:, None].expand(rows, 3))


def test_nothing_adds_up_to_zero():
    assert row_sums(torch.zeros(2, padded(0), dtype=torch.float64)).tolist() == [0.0, 0.0]
