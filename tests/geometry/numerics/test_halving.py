"""Sums by halves are sums, and zeros behind them change no bit."""

import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given
from hypothesis import strategies as st

from torchreg.geometry.numerics.halving import halved, halving_width


def row(count, seed=0):
    return torch.randn(count, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def naive(values):
    """Of a list whose length is a power of two, by recursion."""
    half = len(values) // 2
    return values[0] if half == 0 else naive([a + b for a, b in zip(values[:half], values[half:], strict=True)])


@given(st.integers(0, 70), st.integers(0, 2**31))
def test_halves_are_added_until_one_number_is_left(count, seed):
    values = row(count, seed)
    filled = [*values.tolist(), *[0.0] * (halving_width(count) - count)]
    assert float(halved(values)) == naive(filled)


def test_zeros_behind_and_rows_beside_change_nothing():
    values = row(1500)
    wide = torch.stack([torch.nn.functional.pad(values, (0, 3000)), row(4500, 1)])
    for number in THREADS:
        with threads(number):
            assert same_bits(halved(wide)[0], halved(values))
    assert same_bits(halved(torch.full((3,), -0.0)), halved(torch.full((4,), -0.0)))


def test_the_sum_of_nothing_is_zero():
    assert halved(torch.zeros(2, 0)).tolist() == [0, 0]
