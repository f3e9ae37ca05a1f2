"""The closed form against numpy's, and that it is a rotation whatever comes."""

import oracles
import pytest
import torch
from closeness import assert_rigid, close
from hypothesis import given
from hypothesis import strategies as st
from problems import random_transform
from refusals import refuses

import torchreg as tr


def pair(rows, seed=0, noise=0.0):
    generator = torch.Generator().manual_seed(seed)
    source = torch.randn(rows, 3, dtype=torch.float64, generator=generator)
    T = random_transform(generator)
    target = source @ T[:3, :3].t() + T[:3, 3]
    return source, target + noise * torch.randn(rows, 3, dtype=torch.float64, generator=generator), T


@given(st.integers(0, 2**31), st.integers(3, 50))
def test_the_true_transform_is_found(seed, rows):
    source, target, T = pair(rows, seed)
    assert close(tr.kabsch(source, target), T, atol=1e-7)


@given(st.integers(0, 2**31), st.integers(4, 50), st.floats(0, 2))
def test_noisy_points_give_what_numpy_gives(seed, rows, noise):
    source, target, _ = pair(rows, seed, noise)
    weights = torch.rand(rows, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) + 0.1
    assert close(tr.kabsch(source, target), oracles.kabsch(source, target), atol=1e-6)
    assert close(tr.kabsch(source, target, weights), oracles.kabsch(source, target, weights), atol=1e-6)


def test_no_nearby_transform_is_better():
    source, target, _ = pair(20, noise=0.3)
    best = tr.kabsch(source, target)

    def error(T):
        return float((source @ T[:3, :3].t() + T[:3, 3] - target).square().sum())

    generator = torch.Generator().manual_seed(1)
    for _ in range(50):
        step = torch.zeros(4, 4, dtype=torch.float64)
        step[:3] = 1e-2 * torch.randn(3, 4, dtype=torch.float64, generator=generator)
        step[:3, :3] -= step[:3, :3].t().clone()
        assert error(torch.matrix_exp(step) @ best) > error(best)


@given(st.integers(0, 2**31))
def test_a_mirrored_set_never_gives_a_reflection(seed):
    source, target, _ = pair(10, seed)
    T = tr.kabsch(source, target * torch.tensor([1.0, 1, -1]))
    assert_rigid(T)


@pytest.mark.parametrize("rows", [0, 1, 2, 5])
@pytest.mark.parametrize("shape", ["line", "place"])
def test_points_that_leave_the_rotation_open_still_give_a_rotation(rows, shape):
    along = torch.arange(rows, dtype=torch.float64)[:, None] * torch.tensor([[1.0, 2, 3]])
    source = along if shape == "line" else torch.ones(rows, 3, dtype=torch.float64)
    target = source @ torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]], dtype=torch.float64) + 4
    T = tr.kabsch(source, target)
    assert_rigid(T)
    assert close(source @ T[:3, :3].t() + T[:3, 3], target, atol=1e-12)


def test_rows_of_weight_zero_do_not_count():
    source, target, T = pair(10)
    target[5:] += 100
    weights = (torch.arange(10) < 5).double()
    assert close(tr.kabsch(source, target, weights), T, atol=1e-12)


def test_no_weight_at_all_gives_a_rotation():
    source, target, _ = pair(5)
    assert_rigid(tr.kabsch(source, target, torch.zeros(5, dtype=torch.float64)))


def test_a_batch_equals_the_loop_over_it():
    made = [pair(8, seed, 0.2) for seed in range(6)]
    source, target = (torch.stack([one[side] for one in made]) for side in (0, 1))
    batch = tr.kabsch(source.reshape(2, 3, 8, 3), target.reshape(2, 3, 8, 3)).reshape(6, 4, 4)
    for one, (p, q, _) in zip(batch, made, strict=True):
        assert close(one, tr.kabsch(p, q), atol=1e-12)


def test_swapped_sets_give_the_inverse():
    source, target, _ = pair(10, noise=0.2)
    forth, back = tr.kabsch(source, target), tr.kabsch(target, source)
    assert close(forth @ back, torch.eye(4, dtype=torch.float64), atol=1e-12)


def test_gradients_are_right():
    source, target, _ = pair(6, noise=0.3)
    weights = torch.rand(6, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) + 0.1
    inputs = [value.requires_grad_() for value in (source, target, weights)]
    assert torch.autograd.gradcheck(tr.kabsch, inputs)


def test_the_dtype_stays():
    source, target, T = pair(10)
    found = tr.kabsch(source.float(), target.float())
    assert found.dtype == torch.float32
    assert close(found.double(), T, atol=1e-5)


def test_shapes_that_do_not_fit_are_refused():
    with refuses("source", "(..., M, 3)", "(5, 2)"):
        tr.kabsch(torch.zeros(5, 2), torch.zeros(5, 2))
    with refuses("target", "(5, 3)", "(4, 3)"):
        tr.kabsch(torch.zeros(5, 3), torch.zeros(4, 3))
    with refuses("weights", "(5,)", "(5, 1)"):
        tr.kabsch(torch.zeros(5, 3), torch.zeros(5, 3), torch.zeros(5, 1))
