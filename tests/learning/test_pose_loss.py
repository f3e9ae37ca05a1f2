"""The pose loss: the metrics in radians and meters, with gradients everywhere, at 0 and 180 degrees too."""

import math

import pytest
import torch
from closeness import close
from hypothesis import given
from hypothesis import strategies as st
from problems import random_transform, turned
from refusals import refuses
from torch.autograd import gradcheck, gradgradcheck

import torchreg as tr
from torchreg.learning import pose_loss

EYE = torch.eye(4, dtype=torch.float64)


def transforms(seed, count=3):
    generator = torch.Generator().manual_seed(seed)
    return torch.stack([random_transform(generator) for _ in range(count)])


@given(st.integers(0, 2**31))
def test_it_measures_what_the_metrics_measure(seed):
    estimated, true = transforms(seed), transforms(seed + 1)
    loss = pose_loss(estimated, true, rotation_weight=2.0, translation_weight=0.5)
    assert close(torch.rad2deg(loss.rotation), tr.metrics.rre(true, estimated), atol=1e-9)
    assert close(loss.translation, tr.metrics.rte(true, estimated), atol=1e-12)
    assert close(loss.total, 2 * loss.rotation + 0.5 * loss.translation, atol=1e-12)


@given(st.integers(0, 2**31))
def test_it_does_not_depend_on_the_target_frame_nor_on_which_pose_is_true(seed):
    estimated, true, other = transforms(seed)
    loss = pose_loss(estimated, true)
    assert close(pose_loss(other @ estimated, other @ true).total, loss.total, atol=1e-7)
    assert close(pose_loss(true, estimated).total, loss.total, atol=1e-7)
    assert close(pose_loss(estimated @ other, true @ other).rotation, loss.rotation, atol=1e-7)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, math.pi / 2, 3.0, math.pi - 1e-7, math.pi])
def test_the_angle_of_a_turn_is_its_angle(angle):
    assert abs(float(pose_loss(turned(math.degrees(angle), (1.0, 2.0, -1.0)), EYE).rotation) - angle) < 1e-12


def test_derivatives_are_exact():
    inputs = transforms(0).requires_grad_(), transforms(1).requires_grad_()
    assert gradcheck(pose_loss, inputs)
    assert gradgradcheck(lambda *T: pose_loss(*T).total, inputs)


def test_one_true_pose_serves_many_estimates():
    estimated, true = transforms(0), transforms(1, 1)[0]
    one_by_one = torch.stack([pose_loss(one, true).total for one in estimated])
    assert close(pose_loss(estimated, true).total, one_by_one, atol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-4, math.pi - 1e-4, math.pi - 1e-12, math.pi])
def test_gradients_are_finite_and_no_longer_than_one_per_entry(angle, dtype):
    estimated = turned(math.degrees(angle)).to(dtype).requires_grad_()
    first, *_ = torch.autograd.grad(pose_loss(estimated, EYE.to(dtype)).total, estimated, create_graph=True)
    assert first.isfinite().all()
    assert first.abs().max() <= 1 + 1e-6
    (second,) = torch.autograd.grad(first.square().sum(), estimated)
    assert second.isfinite().all()


def test_gradients_are_zero_exactly_at_the_truth_and_full_beside_it():
    at = EYE.clone().requires_grad_()
    assert torch.autograd.grad(pose_loss(at, EYE).total, at)[0].eq(0).all()
    beside = turned(math.degrees(1e-9)).requires_grad_()
    assert torch.autograd.grad(pose_loss(beside, EYE).total, beside)[0].norm() > 0.5


def test_half_a_turn_has_a_zero_gradient_too():
    opposite = torch.diag(torch.tensor([1.0, -1, -1, 1])).requires_grad_()
    loss = pose_loss(opposite, torch.eye(4)).rotation
    assert float(loss.detach()) == pytest.approx(math.pi)
    assert torch.autograd.grad(loss, opposite)[0].eq(0).all()


def test_a_matrix_that_is_no_rotation_has_finite_gradients():
    flat = torch.diag(torch.tensor([1.0, 0, 0, 1])).requires_grad_()
    assert torch.autograd.grad(pose_loss(flat, torch.eye(4)).total, flat)[0].isfinite().all()


def test_a_true_pose_of_another_dtype_is_taken_to_that_of_the_estimate():
    estimated, true = transforms(0), transforms(1)
    loss = pose_loss(estimated.float(), true)
    assert loss.total.dtype == torch.float32
    assert close(loss.total.double(), pose_loss(estimated, true).total, atol=1e-5)


def test_descent_finds_the_true_pose():
    source = torch.rand(10, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    true = transforms(3, 1)[0]
    target = (source @ true[:3, :3].t() + true[:3, 3]).flip(0).requires_grad_()
    optimizer = torch.optim.Adam([target], lr=0.05)
    before = float(pose_loss(tr.kabsch(source, target), true).total.detach())
    for _ in range(150):
        optimizer.zero_grad()
        loss = pose_loss(tr.kabsch(source, target), true).total
        loss.backward()
        optimizer.step()
    assert before > 1
    assert loss < 0.1


def test_what_does_not_fit_is_refused():
    with refuses("T_estimated", "(..., 4, 4)", "(3, 3)"):
        pose_loss(torch.eye(3), torch.eye(4))
    with refuses("T_true", "floating", "int64"):
        pose_loss(torch.eye(4), torch.eye(4).long())
    with refuses("rotation_weight", "at least 0", "-1"):
        pose_loss(torch.eye(4), torch.eye(4), rotation_weight=-1)
    with refuses("translation_weight", "at least 0", "nan"):
        pose_loss(torch.eye(4), torch.eye(4), translation_weight=math.nan)
