"""The best pose over all pairs is that over a list of them, one row each."""

import pytest
import torch
from closeness import close
from hypothesis import given
from hypothesis import strategies as st
from problems import numbers, random_transform
from refusals import refuses
from torch.autograd import gradcheck, gradgradcheck

import torchreg as tr
from torchreg.geometry.soft_kabsch import soft_kabsch
from torchreg.matching.soft import expected_targets


@given(st.integers(0, 2**31), st.integers(2, 9), st.integers(2, 9))
def test_it_is_kabsch_over_the_list_of_all_pairs_and_over_expected_partners(seed, rows, columns):
    source, target = numbers(rows, 3, seed=seed), numbers(columns, 3, seed=seed + 1)
    confidence = numbers(rows, columns, seed=seed + 2).abs() + 0.01
    found = soft_kabsch(source, target, confidence)
    i, k = torch.cartesian_prod(torch.arange(rows), torch.arange(columns)).unbind(1)
    listed = tr.kabsch(source[i], target[k], confidence[i, k])

    def cost(T):
        moved = source @ T[:3, :3].t() + T[:3, 3]
        return float((confidence * (moved[:, None] - target).square().sum(dim=2)).sum())

    assert cost(found) == pytest.approx(cost(listed), rel=1e-9)  # two points leave a turn open
    partners = expected_targets(confidence, target)
    assert cost(found) == pytest.approx(cost(tr.kabsch(source, *partners)), rel=1e-9)
    if min(rows, columns) > 3:
        assert close(found, listed, atol=1e-6)


def test_a_batch_is_the_loop_and_the_map_over_its_pairs():
    source, target, confidence = numbers(4, 6, 3), numbers(4, 5, 3, seed=1), numbers(4, 6, 5).abs()
    whole = soft_kabsch(source, target, confidence)
    mapped = torch.func.vmap(soft_kabsch)(source, target, confidence)
    for b in range(4):
        alone = soft_kabsch(source[b], target[b], confidence[b])
        assert close(whole[b], alone, atol=1e-12)
        assert close(mapped[b], alone, atol=1e-12)


@pytest.mark.parametrize("shape", [(5, 4), (3, 6)], ids=str)
def test_first_and_second_derivatives_are_exact(shape):
    inputs = numbers(shape[0], 3), numbers(shape[1], 3, seed=1), numbers(*shape, seed=2).abs() + 0.1
    inputs = tuple(value.requires_grad_() for value in inputs)
    assert gradcheck(soft_kabsch, inputs)
    assert gradgradcheck(soft_kabsch, inputs, atol=1e-4)


TROUBLE = {
    "nothing counts": (numbers(4, 3), numbers(5, 3), torch.zeros(4, 5).double()),
    "hardly anything counts": (numbers(4, 3), numbers(5, 3), 1e-300 * numbers(4, 5).abs()),
    "one pair": (numbers(1, 3), numbers(1, 3, seed=1), torch.ones(1, 1).double()),
    "one place": (torch.ones(4, 3).double(), numbers(5, 3), numbers(4, 5).abs()),
    "all pairs alike": (numbers(4, 3), numbers(5, 3), torch.ones(4, 5).double()),
    "no source": (numbers(0, 3), numbers(5, 3), numbers(0, 5)),
    "nobody": (numbers(0, 3), numbers(0, 3), numbers(0, 0)),
}


@pytest.mark.parametrize("name", TROUBLE)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_leaves_the_pose_open_gives_a_rotation_and_finite_gradients(name, dtype):
    inputs = [value.to(dtype).requires_grad_() for value in TROUBLE[name]]
    T = soft_kabsch(*inputs)
    R = T[:3, :3]
    assert close(R @ R.t(), torch.eye(3, dtype=dtype), atol=1e-5)
    assert torch.det(R) > 0
    for grad in torch.autograd.grad(T.square().sum() + T[0].sum(), inputs):
        assert torch.isfinite(grad).all()


def test_bits_of_the_true_pose_come_back_through_confident_pairs_among_others_of_no_weight():
    T = random_transform(torch.Generator().manual_seed(0))
    source = numbers(30, 3)
    shuffled = torch.randperm(30, generator=torch.Generator().manual_seed(1))
    target = (source @ T[:3, :3].t() + T[:3, 3])[shuffled]
    confidence = torch.zeros(30, 30, dtype=torch.float64)
    confidence[shuffled, torch.arange(30)] = 0.3
    assert close(soft_kabsch(source, target, confidence), T, atol=1e-12)


def test_bad_arguments_are_refused():
    source, target, confidence = numbers(3, 3), numbers(4, 3), numbers(3, 4)
    with refuses("source", "(..., N, 3)"):
        soft_kabsch(source[:, :2], target, confidence)
    with refuses("target", "M, 3)"):
        soft_kabsch(source, target[:, :2], confidence)
    with refuses("target", "(2, M, 3)"):
        soft_kabsch(source.expand(2, 3, 3), target, confidence)
    with refuses("confidence", "(3, 4)"):
        soft_kabsch(source, target, confidence.t())
