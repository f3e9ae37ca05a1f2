"""Votes are counted exactly, and weighted sums add a row's neighbors in the row's own order."""

import pytest
import torch
from closeness import close
from determinism import THREADS, pieces, same_bits, threads
from hypothesis import given
from hypothesis import strategies as st

from torchreg.descriptors.histograms import count_votes, inverse_square_weights, neighbor_votes, weighted_sum


@given(st.integers(0, 2**31), st.integers(1, 12), st.integers(0, 20), st.integers(1, 15))
def test_votes_are_counted(seed, rows, slots, size):
    generator = torch.Generator().manual_seed(seed)
    bins = torch.randint(size, (rows, slots), generator=generator)
    votes = torch.randint(0, 3, (rows, slots), generator=generator)
    expected = [[sum(int(v) for b, v in zip(*row, strict=True) if b == k) for k in range(size)]
                for row in zip(bins, votes, strict=True)]  # fmt: skip
    assert count_votes(bins, votes, size).tolist() == expected


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_weights_are_inverse_squares_and_zero_where_nothing_counts(dtype):
    square = torch.tensor([[0.0, 4.0, 0.25, 9.0]], dtype=dtype)
    counted = torch.tensor([[True, True, True, False]])
    assert inverse_square_weights(square, counted).tolist() == [[0, 0.25, 4, 0]]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_weights_are_never_infinite(dtype):
    finfo = torch.finfo(dtype)
    square = torch.tensor([[finfo.smallest_normal / 8, finfo.smallest_normal, finfo.max]], dtype=dtype)
    assert torch.isfinite(inverse_square_weights(square, torch.ones(1, 3, dtype=torch.bool))).all()


@pytest.mark.parametrize("bad", [1e30, 1e-40, float("inf"), -1.0])
def test_distances_in_slots_that_do_not_count_may_be_anything(bad):
    square = torch.tensor([[4.0, bad]])
    assert inverse_square_weights(square, torch.tensor([[True, False]])).tolist() == [[0.25, 0]]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_weighted_sum_adds_the_neighbors_of_a_row(dtype):
    generator = torch.Generator().manual_seed(0)
    table = torch.rand(40, 7, generator=generator, dtype=dtype)
    index = torch.randint(40, (25, 6), generator=generator)
    weights = torch.rand(25, 6, generator=generator, dtype=dtype)
    expected = (table.double()[index] * weights.double()[..., None]).sum(dim=1)
    found = weighted_sum(table, index, weights)
    assert found.dtype == dtype
    assert close(found.double(), expected, atol=1e-5 if dtype == torch.float32 else 1e-14)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_weighted_sum_has_its_bits_for_any_cut_and_threads(dtype):
    generator = torch.Generator().manual_seed(1)
    table = torch.rand(3000, 33, generator=generator, dtype=dtype)
    index = torch.randint(3000, (3000, 40), generator=generator)
    weights = torch.rand(3000, 40, generator=generator, dtype=dtype)
    expected = weighted_sum(table, index, weights)
    for number in THREADS:
        with threads(number), pieces(33 * 40 * 17):
            assert same_bits(weighted_sum(table, index, weights), expected)
            for cut in (slice(5, 6), slice(100, 1111)):
                assert same_bits(weighted_sum(table, index[cut], weights[cut]), expected[cut])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_weighted_sums_of_no_rows(dtype):
    table = torch.rand(4, 3, dtype=dtype)
    none = weighted_sum(table, torch.zeros(0, 5, dtype=torch.int64), torch.zeros(0, 5, dtype=dtype))
    assert none.shape == (0, 3)


def test_gradients_of_a_weighted_sum_are_right():
    generator = torch.Generator().manual_seed(2)
    table = torch.rand(6, 3, generator=generator, dtype=torch.float64).requires_grad_()
    weights = torch.rand(4, 5, generator=generator, dtype=torch.float64).requires_grad_()
    index = torch.randint(6, (4, 5), generator=generator)
    assert torch.autograd.gradcheck(lambda t, w: weighted_sum(t, index, w), (table, weights))


def test_a_point_does_not_vote_on_itself_wherever_it_stands_in_its_row():
    index = torch.tensor([[0, 1, 2], [0, 1, 2], [0, 1, 2]])
    valid = torch.tensor([[True, True, False], [True, True, True], [True, True, True]])
    found = neighbor_votes(index, valid, slice(1, 3))
    assert found.tolist() == [[True, False, True], [True, True, False]]
