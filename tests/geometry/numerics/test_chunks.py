"""Pieces cover all rows once, and a stable sum has one order whatever the threads."""

import math

import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given
from hypothesis import strategies as st

from torchreg.geometry.numerics.chunks import row_chunks, stable_sum


def wild(*shape, seed=0, dtype=torch.float64):
    """Numbers of both signs over many magnitudes: another order of addition shows."""
    generator = torch.Generator().manual_seed(seed)
    exponent = torch.rand(*shape, generator=generator, dtype=torch.float64) * 12 - 6
    sign = torch.randint(2, shape, generator=generator) * 2.0 - 1
    return (sign * torch.pow(10.0, exponent)).to(dtype)


@given(st.integers(0, 500), st.integers(0, 50), st.integers(1, 2000))
def test_chunks_cover_all_rows_once(rows, width, elements):
    covered = [row for piece in row_chunks(rows, width, elements) for row in range(piece.start, piece.stop)]
    assert covered == list(range(rows))


@given(st.integers(1, 500), st.integers(1, 50), st.integers(1, 2000))
def test_chunks_keep_to_the_budget(rows, width, elements):
    longest = max(piece.stop - piece.start for piece in row_chunks(rows, width, elements))
    assert longest * width <= elements or longest == 1


@pytest.mark.parametrize(
    "shape", [(0,), (1,), (1023,), (1024,), (1025,), (2048,), (100_003,), (70_000, 3), (40_000, 1)]
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_sum_has_the_same_bits_for_any_number_of_threads(shape, dtype):
    values = wild(*shape, dtype=dtype)
    sums = []
    for number in THREADS:
        with threads(number):
            sums.append(stable_sum(values))
    assert all(same_bits(one, sums[0]) for one in sums)
    assert sums[0].shape == shape[1:]
    assert sums[0].dtype == dtype


def test_a_plain_sum_does_depend_on_the_threads():
    values = wild(1_000_003)
    sums = []
    for number in THREADS:
        with threads(number):
            sums.append(values.sum())
    assert not all(same_bits(one, sums[0]) for one in sums)


@pytest.mark.parametrize("rows", [1, 1023, 1024, 1025, 5000, 100_003])
def test_a_sum_is_right_within_rounding(rows):
    values = wild(rows, seed=rows)
    exact, size = math.fsum(values.tolist()), math.fsum(values.abs().tolist())
    # blocks of 1,024, then their sums one after another: no number is added to more often than this
    assert abs(float(stable_sum(values)) - exact) <= (1024 + rows / 1024) * 2.3e-16 * size


def test_columns_are_summed_as_if_alone():
    values = wild(5000, 7, seed=3)
    together = stable_sum(values)
    assert all(same_bits(together[c], stable_sum(values[:, c])) for c in range(7))
    assert same_bits(stable_sum(values.t().contiguous().t()), together)


def test_a_sum_of_nothing_is_zero():
    assert stable_sum(torch.zeros(0, 2, 3)).tolist() == [[0, 0, 0]] * 2


def test_gradients_flow_through_a_sum():
    values = wild(1500, 2, seed=5).requires_grad_()
    stable_sum(values).sum().backward()
    assert torch.equal(values.grad, torch.ones_like(values))
