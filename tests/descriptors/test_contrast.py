"""Contrast against plain loops, and what a dimmed light does to it."""

import oracles
import pytest
import torch
from closeness import close
from determinism import same_bits
from problems import random_transform, room_pair, sphere_cloud
from refusals import refuses

import torchreg as tr


@pytest.mark.parametrize("seed", range(3))
def test_values_are_those_of_plain_loops(seed):
    cloud = sphere_cloud(120, seed=seed)
    near = tr.neighbors(cloud, 0.7, 60)
    found = tr.contrast(cloud, near, 0.7)
    assert found.blocks == (("contrast", 10),)
    assert close(found.values, oracles.contrast(cloud.colors, near, 0.7), atol=1e-9)


def test_float32_is_within_rounding():
    scan = room_pair(500).source
    near = tr.neighbors(scan, 0.9, 60)
    expected = oracles.contrast(scan.colors, near, 0.9)
    assert close(tr.contrast(scan, near, 0.9).values.double(), expected, atol=1e-3)


def test_one_color_has_no_contrast_but_the_constant():
    cloud = sphere_cloud(80)
    plain = tr.Clouds(points=cloud.points, colors=torch.full_like(cloud.points, 0.4))
    features = tr.contrast(plain, tr.neighbors(plain, 0.8, 40), 0.8)
    assert close(features.values[features.valid, :9], torch.zeros(9, dtype=torch.float64), atol=1e-12)
    assert torch.allclose(features.values[features.valid, 9], torch.tensor(0.3, dtype=torch.float64))


def test_a_dimmed_light_hardly_shows():
    cloud = sphere_cloud(300)
    bright = tr.Clouds(points=cloud.points, colors=0.5 + 0.5 * cloud.colors)
    near = tr.neighbors(bright, 0.6, 60)
    light = torch.tensor([0.8, 0.7, 0.9], dtype=torch.float64)
    dimmed = tr.Clouds(points=cloud.points, colors=bright.colors * light)
    difference = tr.contrast(bright, near, 0.6).values - tr.contrast(dimmed, near, 0.6).values
    darkened = tr.Clouds(points=cloud.points, colors=bright.colors - 0.3)  # not a light: contrast grows
    assert difference.abs().max() < 0.02
    assert (tr.contrast(bright, near, 0.6).values - tr.contrast(darkened, near, 0.6).values).abs().max() > 0.1


def test_a_rigid_motion_changes_nothing():
    cloud = sphere_cloud(200)
    expected = tr.contrast(cloud, tr.neighbors(cloud, 0.6, 60), 0.6).values
    moved = tr.transform(cloud, random_transform(torch.Generator().manual_seed(1)))
    assert close(tr.contrast(moved, tr.neighbors(moved, 0.6, 60), 0.6).values, expected, atol=1e-9)


def test_a_point_alone_is_not_valid():
    points = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [9.0, 9, 9]])
    cloud = tr.Clouds(points=points, colors=torch.rand(3, 3, generator=torch.Generator().manual_seed(0)))
    features = tr.contrast(cloud, tr.neighbors(cloud, 1.0, 3), 1.0)
    assert features.valid.tolist() == [True, True, False]
    assert features.values[2].tolist() == [0] * 10


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_black_and_white_stay_finite(level):
    cloud = sphere_cloud(50)
    plain = tr.Clouds(points=cloud.points, colors=torch.full_like(cloud.points, level))
    assert torch.isfinite(tr.contrast(plain, tr.neighbors(plain, 0.8, 40), 0.8).values).all()


def test_a_radius_per_point_is_the_radius_of_that_point():
    scan = room_pair(400).source
    near = tr.neighbors(scan, 1.0, 50)
    radius = torch.where(torch.arange(len(near)) % 2 == 0, 0.6, 1.0).double()
    mixed = tr.contrast(scan, near, radius).values
    assert same_bits(mixed[::2], tr.contrast(scan, near, 0.6).values[::2])
    assert same_bits(mixed[1::2], tr.contrast(scan, near, 1.0).values[1::2])


def test_what_does_not_fit_is_refused():
    cloud = sphere_cloud(10)
    near = tr.neighbors(cloud, 1.0, 5)
    with refuses("cloud", "colors", "none"):
        tr.contrast(tr.Clouds(points=cloud.points), near, 1.0)
    with refuses("radius", "above 0", "0"):
        tr.contrast(cloud, near, 0)
    with refuses("radius", "(10,)", "(3,)"):
        tr.contrast(cloud, near, torch.ones(3))
    with refuses("near", "3 points", "10"):
        tr.contrast(cloud.rows(torch.arange(3), torch.tensor([0, 3])), near, 1.0)
