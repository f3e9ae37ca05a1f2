"""Random motions: rigid, within their limits, even over all rotations, about the cloud's zero."""

import math

import pytest
import torch
from refusals import refuses

import torchreg as tr
from torchreg.augment import RandomMotion
from torchreg.geometry.se3 import inverse, transform


def motions(count: int, **options) -> torch.Tensor:
    """(count, 4, 4) drawn for small clouds at zero."""
    clouds = tr.Clouds.pack([tr.Clouds(torch.rand(2, 3))] * count)
    return RandomMotion(**options).tracked(clouds).T_new_old


def angles(T: torch.Tensor) -> torch.Tensor:
    return torch.rad2deg(torch.acos(((T[:, 0, 0] + T[:, 1, 1] + T[:, 2, 2] - 1) / 2).clamp(-1, 1)))


def test_the_way_back_gives_the_cloud_again(batch):
    moved = RandomMotion(shift=5.0).tracked(batch)
    back = transform(moved.clouds, inverse(moved.T_new_old))
    for new, old in ((back.points, batch.points), (back.normals, batch.normals), (back.viewpoint, batch.viewpoint)):
        assert torch.allclose(new, old, atol=1e-5)
    assert torch.allclose(back.origin, batch.origin, atol=1e-12)


def test_far_origins_do_not_throw_clouds_across_the_country():
    far = tr.Clouds(torch.rand(5, 3), origin=torch.tensor([[5e5, 4e6, 100.0]], dtype=torch.float64))
    moved = RandomMotion(shift=2.0).tracked(far)
    assert (moved.clouds.origin - far.origin).norm() <= 2.0
    assert moved.T_new_old[0, :3, :3].trace() < 2.99
    direct = (moved.T_new_old[0, :3, :3] @ (far.points.double() + far.origin).T).T + moved.T_new_old[0, :3, 3]
    assert torch.allclose(direct, moved.clouds.points.double() + moved.clouds.origin, atol=1e-6)


def test_motions_are_rigid_and_within_limits():
    T = motions(300, angle=40, shift=2.0)
    assert torch.allclose(T[:, :3, :3] @ T[:, :3, :3].mT, torch.eye(3, dtype=torch.float64).expand(300, 3, 3))
    assert torch.allclose(torch.linalg.det(T[:, :3, :3]), torch.ones(300, dtype=torch.float64))
    assert angles(T).max() <= 40 + 1e-6
    assert angles(T).median() > 20  # more room at large angles
    assert 1.9 < T[:, :3, 3].norm(dim=1).max() <= 2.0
    assert motions(1, angle=0.0, shift=0.0)[0].tolist() == torch.eye(4).tolist()


def test_half_a_turn_is_uniform_over_rotations():
    """The mean of a uniform rotation is zero, and the share of angles below a is (a - sin a) / pi."""
    T = motions(2000, angle=180)
    assert T[:, :3, :3].mean(dim=0).abs().max() < 0.06
    for degrees in (60, 90, 120, 150):
        a = math.radians(degrees)
        assert (angles(T) < degrees).double().mean() == pytest.approx((a - math.sin(a)) / math.pi, abs=0.035)


def test_up_keeps_the_plumb_line():
    T = motions(200, axis="up", angle=90, shift=0.0)
    up = torch.tensor([0.0, 0, 1, 0], dtype=torch.float64)
    assert torch.allclose(T[:, :, 2], up.expand(200, 4))
    heading = torch.rad2deg(torch.atan2(T[:, 1, 0], T[:, 0, 0]))
    assert heading.abs().max() <= 90
    assert heading.min() < -70
    assert heading.max() > 70
    assert 30 < heading.abs().median() < 60


def test_small_angles_are_not_lost_to_rounding():
    T = motions(200, angle=1e-3, shift=0.0)
    turned = torch.rad2deg((T[:, :3, :3] - T[:, :3, :3].mT).flatten(1).norm(dim=1) / 8**0.5)
    assert turned.max() <= 1.0001e-3
    assert 6e-4 < turned.median() < 9e-4


def test_refusals():
    with refuses("angle", "degrees in [0, 180]", "181"):
        RandomMotion(angle=181)
    with refuses("shift", "meters of at least 0", "-1"):
        RandomMotion(shift=-1.0)
    with refuses("axis", "'any', 'up'"):
        RandomMotion(axis="down")
