"""Eigenvectors of symmetric 3x3 matrices against LAPACK's, degenerate ones included."""

import pytest
import torch
from determinism import same_bits
from hypothesis import given
from hypothesis import strategies as st
from problems import random_rotation
from refusals import refuses

from torchreg.geometry.eigen import symmetric_eigen


def rotated(*values, seed=0):
    R = random_rotation(torch.Generator().manual_seed(seed))
    matrix = R @ torch.diag(torch.tensor(values, dtype=torch.float64)) @ R.t()
    return (matrix + matrix.t()) / 2


def check(matrix, tolerance=1e-14):
    values, vectors = symmetric_eigen(matrix)
    scale = matrix.abs().amax(dim=(-2, -1), keepdim=True)[..., 0]
    expected = torch.linalg.eigvalsh(matrix)
    assert ((values - expected).abs() <= 4 * tolerance * scale).all()
    assert (values.diff(dim=-1) >= 0).all()
    identity = torch.eye(3, dtype=matrix.dtype).expand_as(matrix)
    assert torch.allclose(vectors.transpose(-1, -2) @ vectors, identity, atol=4 * tolerance, rtol=0)
    error = (matrix @ vectors - vectors * values[..., None, :]).abs().amax(dim=(-2, -1))
    assert (error <= 8 * tolerance * scale[..., 0]).all()


def test_random_matrices():
    a = torch.randn(1000, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    check(a + a.transpose(1, 2))


@given(st.integers(0, 2**31), st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3))
def test_matrices_of_any_eigenvalues(seed, values):
    check(rotated(*values, seed=seed))


@pytest.mark.parametrize(
    "values",
    [
        (0, 0, 1),
        (0, 1, 1),
        (1, 1, 1),
        (1, 1, 2),
        (1, 2, 2),
        (1, 1 + 1e-15, 1 + 2e-15),
        (1e-20, 1, 1),
        (1e-300, 1e-300, 1e-300),
        (-1, 0, 1),
        (-1, -1, 5),
        (1e-8, 1, 1e8),
        (1e100, 2e100, 3e100),
    ],
)
@pytest.mark.parametrize("seed", range(4))
def test_degenerate_matrices(values, seed):
    check(rotated(*values, seed=seed))


@pytest.mark.parametrize(
    "matrix",
    [
        [[1, 1, 1], [1, 1, 1], [1, 1, 1]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
        [[2, 0, 0], [0, 1, 0], [0, 0, 3]],
        [[1, 1e-160, 0], [1e-160, 1, 1e-160], [0, 1e-160, 1]],
    ],
)
def test_matrices_of_one_kind(matrix):
    check(torch.tensor(matrix, dtype=torch.float64))


def test_the_zero_matrix_gives_the_identity():
    values, vectors = symmetric_eigen(torch.zeros(3, 3, dtype=torch.float64))
    assert values.tolist() == [0, 0, 0]
    assert torch.equal(vectors, torch.eye(3, dtype=torch.float64))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_matrix_that_is_not_finite_is_no_error_and_leaves_the_others_alone(bad):
    matrices = torch.stack([rotated(1, 2, 3), torch.full((3, 3), bad, dtype=torch.float64), rotated(4, 5, 6)])
    values, vectors = symmetric_eigen(matrices)
    alone_values, alone_vectors = symmetric_eigen(matrices[::2])
    assert same_bits(values[::2], alone_values)
    assert same_bits(vectors[::2], alone_vectors)


def test_only_the_upper_triangle_is_read():
    matrix = rotated(1, 2, 3)
    assert same_bits(symmetric_eigen(matrix.triu()), symmetric_eigen(matrix))


def test_any_batch_shape_and_place_give_the_same_bits():
    a = torch.randn(35, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    matrices = a @ a.transpose(1, 2)
    values, vectors = symmetric_eigen(matrices)
    shaped = symmetric_eigen(matrices.reshape(5, 7, 3, 3))
    assert same_bits(shaped[0].reshape(35, 3), values)
    assert same_bits(shaped[1].reshape(35, 3, 3), vectors)
    for row in range(35):
        assert same_bits(symmetric_eigen(matrices[row]), (values[row], vectors[row]))


def test_float32_stays_float32():
    matrix = rotated(1, 2, 3).float()
    values, vectors = symmetric_eigen(matrix)
    assert values.dtype == vectors.dtype == torch.float32
    check(matrix, 1e-6)


def test_no_gradient_flows_through_the_iteration():
    values, vectors = symmetric_eigen(rotated(1, 2, 4).requires_grad_())
    assert not values.requires_grad
    assert not vectors.requires_grad


def test_another_shape_is_refused():
    with refuses("matrix", "(..., 3, 3)", "(3, 2)"):
        symmetric_eigen(torch.zeros(3, 2))
