"""Which points a picture shows: thinning, and where rooms are cut open."""

import numpy as np
import pytest
import torch
from problems import random_transform

import torchreg as tr
from torchreg.report.scene import box, scene_of, thin
from torchreg.report.views import VIEWS, slice_of


def shell(seed=0, size=(8.0, 6.0, 3.0), count=4000):
    """Points (N, 3) on the six faces of a box."""
    rng = np.random.default_rng(seed)
    points = rng.random((count, 3))
    axis = rng.integers(3, size=count)
    points[np.arange(count), axis] = rng.integers(2, size=count)
    return points * size


def test_thin_keeps_few_and_far_points():
    rng = np.random.default_rng(0)
    crowd, few = 0.01 * rng.random((20_000, 3)), 10 * rng.random((300, 3))
    rows = thin(np.concatenate((crowd, few)), 1000)
    assert len(rows) == len(set(rows.tolist())) == 1000
    assert (rows >= 20_000).sum() > 290
    assert np.array_equal(rows, thin(np.concatenate((crowd, few)), 1000))


def test_thin_gives_all_of_few_in_an_even_order():
    points = np.linspace(0, 1, 500)[:, None] * np.ones(3)
    rows = thin(points, 1000)
    assert sorted(rows.tolist()) == list(range(500))
    assert 0.3 < points[rows[:100]].mean() < 0.7


def test_thin_drops_what_is_not_finite():
    points = np.ones((10, 3))
    points[2, 1], points[5, 0] = np.nan, -np.inf
    assert sorted(thin(points, 100).tolist()) == [0, 1, 3, 4, 6, 7, 8, 9]
    assert len(thin(points, 4)) == 4
    assert len(thin(np.full((5, 3), np.nan), 4)) == 0


def test_box_does_not_follow_stray_points():
    points = np.random.default_rng(0).random((5000, 3))
    points[0] = 1e6
    low, high = box(points)
    assert (high < 1.01).all()
    assert (low > -0.01).all()
    few_low, few_high = box(points[:3])
    assert (few_high == points[:3].max(axis=0)).all()
    assert (few_low == points[:3].min(axis=0)).all()


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_a_closed_room_is_cut_in_the_middle(view):
    points = shell()
    low, high = slice_of(points, view)
    middle = np.array((8.0, 6.0, 3.0))[view.depth] / 2
    assert low < middle < high
    assert 0 < ((points[:, view.depth] > low) & (points[:, view.depth] < high)).mean() < 0.6


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_what_is_not_closed_is_drawn_whole(view):
    wall = np.random.default_rng(0).random((3000, 3))
    wall[:, view.depth] *= 0.01
    assert slice_of(wall, view) is None
    assert slice_of(wall[:0], view) is None
    assert slice_of(np.ones((5, 3)), view) is None


def test_moved_points_are_those_of_transform():
    generator = torch.Generator().manual_seed(0)
    origins = 1e6 * torch.rand(2, 1, 3, dtype=torch.float64, generator=generator)
    source, target = (
        tr.Clouds(points=torch.rand(50, 3, generator=generator), origin=origin.round()) for origin in origins
    )
    T = random_transform(generator, reach=1e5)
    scene = scene_of(source, target, 100)
    moved = tr.transform(source, T)
    expected = moved.points.double() + moved.origin - target.origin  # float32 points: to 0.1 micrometer
    order = thin(source.points.double().numpy(), 100)
    torch.testing.assert_close(torch.from_numpy(scene.moved(T)), expected[order], atol=2e-6, rtol=1e-12)


def test_no_points_are_left_out_of_colors():
    cloud = tr.Clouds(points=torch.rand(30, 3), colors=torch.rand(30, 3))
    scene = scene_of(cloud, cloud, 10)
    assert scene.colors.shape == (20, 3)
    assert scene.counts == (30, 30)
    order = thin(cloud.points.double().numpy(), 10)
    np.testing.assert_array_equal(scene.colors[:10], cloud.colors[order].double().numpy())
    assert scene_of(cloud, tr.Clouds(points=cloud.points), 10).colors is None
