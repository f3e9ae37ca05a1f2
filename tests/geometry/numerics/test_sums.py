"""Sums in lanes against a plain loop, and what must not change a bit of them."""

import math

import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given
from hypothesis import strategies as st

from torchreg.geometry.numerics.sums import lane_sums

LANES = [None, 1, 2, 16, 64]


def wild(*shape, seed=0, dtype=torch.float64):
    """Numbers of both signs over many magnitudes: another order of addition shows."""
    generator = torch.Generator().manual_seed(seed)
    exponent = torch.rand(*shape, generator=generator, dtype=torch.float64) * 12 - 6
    sign = torch.randint(2, shape, generator=generator) * 2.0 - 1
    return (sign * torch.pow(10.0, exponent)).to(dtype)


def naive(values, lanes):
    """Of a list of float64, as the definition reads."""
    most = 1
    while most < len(values):
        most *= 2
    sums = [0.0] * (lanes or most)
    for k, value in enumerate(values):
        sums[k % len(sums)] += value
    while len(sums) > 1:
        half = len(sums) // 2
        sums = [one + other for one, other in zip(sums[:half], sums[half:], strict=True)]
    return sums[0]


@given(st.integers(0, 300), st.sampled_from(LANES), st.integers(0, 2**31))
def test_the_order_is_that_of_the_definition(count, lanes, seed):
    values = wild(count, seed=seed)
    assert float(lane_sums(values, lanes)) == naive(values.tolist(), lanes)


@given(st.integers(1, 300), st.integers(0, 300), st.sampled_from(LANES))
def test_zeros_behind_and_rows_beside_change_nothing(count, longer, lanes):
    values = wild(3, count, seed=count)
    alone = torch.stack([lane_sums(row, lanes) for row in values])
    filled = torch.nn.functional.pad(values, (0, longer))
    assert same_bits(lane_sums(filled, lanes), alone)
    assert same_bits(lane_sums(filled.t().contiguous().t(), lanes), alone)
    assert same_bits(lane_sums(filled.t(), lanes, dim=0), alone)
    negative = torch.full((count,), -0.0)
    assert same_bits(lane_sums(negative, lanes), torch.tensor(0.0))


@pytest.mark.parametrize("shape", [(1,), (1025,), (100_003,), (70_000, 3), (40_000, 1), (300, 7, 300)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("lanes", [None, 64])
def test_a_sum_has_the_same_bits_for_any_number_of_threads(shape, dtype, lanes):
    values = wild(*shape, dtype=dtype)
    for dim in range(len(shape)):
        sums = []
        for number in THREADS:
            with threads(number):
                sums.append(lane_sums(values, lanes, dim=dim))
        assert all(same_bits(one, sums[0]) for one in sums)
        assert sums[0].shape == shape[:dim] + shape[dim + 1 :]
        assert sums[0].dtype == dtype


def test_a_plain_sum_does_depend_on_the_threads():
    values = wild(1_000_003)
    sums = []
    for number in THREADS:
        with threads(number):
            sums.append(values.sum())
    assert not all(same_bits(one, sums[0]) for one in sums)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("count", [1, 1023, 1025, 5000])
def test_a_sum_is_right_within_rounding(count, lanes):
    values = wild(count, seed=count)
    exact, size = math.fsum(values.tolist()), math.fsum(values.abs().tolist())
    steps = count / lanes + 7 if lanes else math.log2(count) + 1
    # no number is added to more often than this
    assert abs(float(lane_sums(values, lanes)) - exact) <= steps * 1.2e-16 * size


def test_a_sum_of_nothing_is_zero():
    assert lane_sums(torch.zeros(0, 2, 3), dim=0).tolist() == [[0, 0, 0]] * 2
    assert lane_sums(torch.zeros(2, 0), 16).tolist() == [0, 0]


@pytest.mark.parametrize("lanes", [None, 4])
@pytest.mark.parametrize("dim", [0, 1])
def test_gradients_are_those_of_a_sum(lanes, dim):
    values = wild(7, 13, seed=5).requires_grad_()
    lane_sums(values, lanes, dim).sum().backward()
    assert torch.equal(values.grad, torch.ones_like(values))
    small = torch.randn(3, 9, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: lane_sums(x, lanes, dim), (small,))
