"""The errors of Eq. (5) to (7) against hand-made values and the formulas, and recall by both definitions."""

import math

import oracles
import pytest
import torch
from closeness import close
from hypothesis import given
from hypothesis import strategies as st
from problems import random_rotation, random_transform, turned
from refusals import refuses

import torchreg as tr
from torchreg.geometry.se3 import rigid

EYE = torch.eye(4, dtype=torch.float64)


@pytest.mark.parametrize("degrees", [0.0, 1e-9, 1e-6, 1e-3, 1.0, 30.0, 90.0, 150.0, 179.9, 180.0])
@pytest.mark.parametrize("axis", [(0.0, 0, 1), (1.0, 2, 3), (-1.0, 0.5, 0)])
def test_rotation_error_is_the_angle_of_the_turn(degrees, axis):
    generator = torch.Generator().manual_seed(0)
    T = random_transform(generator)
    error = float(tr.metrics.rre(T, T @ turned(degrees, axis)))
    assert error == pytest.approx(degrees, rel=1e-6, abs=1e-13)


@given(st.integers(0, 2**31))
def test_rotation_error_is_that_of_the_formula(seed):
    generator = torch.Generator().manual_seed(seed)
    one, other = random_transform(generator), random_transform(generator)
    assert float(tr.metrics.rre(one, other)) == pytest.approx(oracles.rre(one, other), abs=1e-5)
    assert float(tr.metrics.rre(one, other)) == pytest.approx(float(tr.metrics.rre(other, one)), abs=1e-10)


def test_translation_error_is_a_distance():
    one, other = turned(0, translation=(1.0, 2, 3)), turned(50, translation=(1.0, -1, 7))
    assert float(tr.metrics.rte(one, other)) == 5.0


def test_rmse_of_a_shift_is_its_length():
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert float(tr.metrics.rmse(EYE, turned(0, translation=(0.0, 3, 4)), points)) == pytest.approx(5)


def test_rmse_of_a_half_turn_about_the_z_axis():
    points = torch.tensor([[1.0, 0, 5], [0, 2, -3]], dtype=torch.float64)
    # the points move by 2 and by 4
    assert float(tr.metrics.rmse(EYE, turned(180), points)) == pytest.approx(math.sqrt((4 + 16) / 2))


@given(st.integers(0, 2**31))
def test_rmse_is_that_of_the_formula(seed):
    generator = torch.Generator().manual_seed(seed)
    one, other = random_transform(generator), random_transform(generator)
    points = torch.randn(20, 3, dtype=torch.float64, generator=generator)
    apart = (points @ one[:3, :3].t() + one[:3, 3]) - (points @ other[:3, :3].t() + other[:3, 3])
    expected = float(apart.square().sum(dim=1).mean().sqrt())
    assert float(tr.metrics.rmse(one, other, points)) == pytest.approx(expected, rel=1e-9)


def test_rmse_keeps_its_digits_far_from_zero():
    points = torch.tensor([[5e5, 5e6, 100.0]], dtype=torch.float64)
    T = turned(20, (1.0, 2, 3), (7.0, 8, 9))
    shifted = T.clone()
    shifted[0, 3] += 1e-6
    assert float(tr.metrics.rmse(T, shifted, points)) == pytest.approx(1e-6, rel=1e-6)


def test_batches_are_taken_pair_by_pair():
    generator = torch.Generator().manual_seed(1)
    one = torch.stack([random_transform(generator) for _ in range(6)])
    other = torch.stack([random_transform(generator) for _ in range(6)])
    points = torch.randn(9, 3, dtype=torch.float64, generator=generator)
    for error in (tr.metrics.rre, tr.metrics.rte, lambda a, b: tr.metrics.rmse(a, b, points)):
        together = error(one.reshape(2, 3, 4, 4), other.reshape(2, 3, 4, 4))
        assert together.shape == (2, 3)
        alone = torch.stack([error(a, b) for a, b in zip(one, other, strict=True)])
        assert close(together.reshape(6), alone, atol=1e-12)


def test_equal_transforms_have_no_error():
    T = random_transform(torch.Generator().manual_seed(2))
    points = torch.rand(5, 3, dtype=torch.float64)
    assert float(tr.metrics.rre(T, T)) < 1e-12
    assert float(tr.metrics.rte(T, T)) == 0
    assert float(tr.metrics.rmse(T, T, points)) == 0


def test_gradients_are_right():
    generator = torch.Generator().manual_seed(3)
    R = random_rotation(generator).requires_grad_()
    t = torch.randn(3, dtype=torch.float64, generator=generator).requires_grad_()
    T = random_transform(generator)
    points = torch.randn(5, 3, dtype=torch.float64, generator=generator)
    for error in (tr.metrics.rre, tr.metrics.rte, lambda a, b: tr.metrics.rmse(a, b, points)):
        assert torch.autograd.gradcheck(lambda R, t, error=error: error(T, rigid(R, t)), (R, t))


@pytest.mark.parametrize("error", [tr.metrics.rre, tr.metrics.rte])
def test_what_does_not_fit_is_refused(error):
    with refuses("T_true", "(..., 4, 4)", "(3, 3)"):
        error(torch.eye(3), EYE)
    with refuses("T_estimated", "(..., 4, 4)", "(3, 4)"):
        error(EYE, EYE[:3])


def test_rmse_refuses_what_does_not_fit():
    with refuses("points", "(P, 3)", "(5, 2)"):
        tr.metrics.rmse(EYE, EYE, torch.zeros(5, 2))
    with refuses("points", "at least one"):
        tr.metrics.rmse(EYE, EYE, torch.zeros(0, 3))


def test_pose_errors_of_a_known_difference():
    T = turned(2, translation=(0.0, 0, 3))
    origin = torch.tensor([[9.0, 0, 0]], dtype=torch.float64)
    cloud = tr.Clouds(points=torch.tensor([[1.0, 0, 0], [-1, 0, 0]]), origin=origin)
    errors = tr.metrics.pose_errors(cloud, EYE, T)
    chords = [2 * radius * math.sin(math.radians(1)) for radius in (10, 8)]
    assert errors.rre_degrees == pytest.approx(2)
    assert errors.rte_meters == pytest.approx(math.hypot(3, 2 * 9 * math.sin(math.radians(1))))  # of the origin
    assert errors.rmse_meters == pytest.approx(math.sqrt(sum(chord**2 + 9 for chord in chords) / 2))
    assert all(isinstance(value, float) for value in errors)
    assert tr.metrics.pose_errors(cloud, T, T).rmse_meters == 0


def test_pose_errors_are_those_of_the_scene_whatever_the_zero_of_the_map():
    T_true, T = turned(40, translation=(1.0, -2, 0.5)), turned(40.001, translation=(1.0, -2, 0.503))
    cloud = tr.Clouds(points=torch.rand(50, 3) * 20)
    near = tr.metrics.pose_errors(cloud, T_true, T)
    assert near.rte_meters == pytest.approx(float(tr.metrics.rte(T_true, T)))  # Eq. 6 where the origin is the zero
    place = (500_000.0, 5_400_000.0, 230.0)
    there, back = turned(0, translation=place), turned(0, translation=[-value for value in place])
    mapped = tr.Clouds(points=cloud.points, origin=torch.tensor([place], dtype=torch.float64))
    far = tr.metrics.pose_errors(mapped, there @ T_true @ back, there @ T @ back)
    assert far == pytest.approx(near, abs=1e-7)


def test_pose_errors_refuse_what_does_not_fit():
    cloud = tr.Clouds(points=torch.rand(5, 3))
    with refuses("source", "a batch of one", "cloud[b]", "2 clouds"):
        tr.metrics.pose_errors(tr.Clouds.pack([cloud, cloud]), EYE, EYE)
    with refuses("T_true", "(4, 4)", "(1, 4, 4)"):
        tr.metrics.pose_errors(cloud, EYE[None], EYE)
    with refuses("T_estimated", "(4, 4)", "(3, 4)"):
        tr.metrics.pose_errors(cloud, EYE, EYE[:3])
    with refuses("points", "at least one"):
        tr.metrics.pose_errors(tr.Clouds(points=torch.zeros(0, 3)), EYE, EYE)


def test_both_errors_must_be_below_their_bounds():
    errors = ((14.9, 0.29), (1.0, 0.31), (15.1, 0.1), (0.0, 0.0))
    estimated = torch.stack([turned(degrees, translation=(meters, 0, 0)) for degrees, meters in errors])
    assert tr.metrics.recalled_by_error(EYE.expand(4, 4, 4), estimated).tolist() == [True, False, False, True]
    wide = tr.metrics.recalled_by_error(EYE.expand(4, 4, 4), estimated, rotation=20.0, translation=1.0)
    assert wide.tolist() == [True] * 4


def test_the_error_of_true_correspondences_must_be_below_its_bound():
    errors = torch.tensor([0.1, 0.2, 0.3])
    assert tr.metrics.recalled_by_rmse(errors).tolist() == [True, False, False]
    assert tr.metrics.recalled_by_rmse(errors, bound=0.25).tolist() == [True, True, False]


def test_recall_is_the_share_of_pairs():
    assert float(tr.metrics.registration_recall(torch.tensor([True, False, True, True]))) == 0.75


def test_an_error_that_is_no_number_is_not_recalled():
    assert tr.metrics.recalled_by_rmse(torch.tensor([float("nan")])).tolist() == [False]
    assert tr.metrics.recalled_by_error(EYE, EYE * float("nan")).tolist() is False


@pytest.mark.parametrize("bound", [0, -1.0, float("nan")])
def test_bounds_that_are_not_above_zero_are_refused(bound):
    with refuses("rotation", "above 0"):
        tr.metrics.recalled_by_error(EYE, EYE, rotation=bound)
    with refuses("translation", "above 0"):
        tr.metrics.recalled_by_error(EYE, EYE, translation=bound)
    with refuses("bound", "above 0"):
        tr.metrics.recalled_by_rmse(torch.zeros(1), bound=bound)


def test_recall_of_no_pairs_is_refused():
    with refuses("recalled", "at least one pair"):
        tr.metrics.registration_recall(torch.zeros(0, dtype=torch.bool))
