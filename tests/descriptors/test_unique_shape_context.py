"""Unique shape contexts: 3D shape contexts in the frames of SHOT, which turn with the cloud."""

from dataclasses import replace

import pytest
import torch
from closeness import close
from determinism import same_bits
from problems import random_transform, seeded, sphere_cloud
from refusals import refuses

import torchreg as tr


def described(cloud, radius=0.6, **options):
    return tr.unique_shape_context(cloud, tr.neighbors(cloud, radius, 300), **options)


def test_a_row_has_14_by_14_by_10_cells_and_needs_no_normals():
    cloud = sphere_cloud(150)
    features = described(cloud, 0.3)
    assert features.blocks == (("usc", 1960),)
    assert same_bits(described(tr.Clouds(points=cloud.points), 0.3), features)
    assert 0 < int(features.valid.sum()) < 150
    assert torch.equal(features.valid, tr.local_frames(cloud, tr.neighbors(cloud, 0.3, 300)).any(dim=2).any(dim=1))


@pytest.mark.parametrize("seed", range(3))
def test_a_rigid_motion_changes_nothing(seed):
    cloud = sphere_cloud(200, seed=seed)
    moved = tr.transform(cloud, random_transform(seeded(seed)))
    assert close(described(moved).values, described(cloud).values, atol=1e-6)


def test_a_neighbor_counts_in_the_cell_where_its_frame_has_it():
    points = torch.tensor([[0.0, 0, 0], [0.05, 0.03, 0.4], [-0.02, -0.05, -0.03]], dtype=torch.float64)
    cloud = tr.Clouds(points=points)
    near = tr.neighbors(cloud, 0.5, 3)
    frames = torch.eye(3, dtype=torch.float64).expand(3, 3, 3)
    cells = tr.unique_shape_context(cloud, near, frames=frames).values[0].view(14, 14, 10)
    assert cells.nonzero().tolist() == [[1, 0, 9], [9, 9, 0]]


def test_soft_cells_have_the_gradients_of_differences_through_the_frames():
    cloud = sphere_cloud(9, seed=4)
    near = tr.neighbors(cloud, 2.2, 9)
    weights = torch.rand(1, 1960, generator=seeded(5), dtype=torch.float64)

    def loss(points):
        given = replace(cloud, points=points)
        return (tr.unique_shape_context(given, near, binning="soft").values * weights).sum()

    assert torch.autograd.gradcheck(loss, (cloud.points.clone().requires_grad_(),), atol=1e-4)


def test_an_unknown_binning_is_refused():
    with refuses("binning"):
        described(sphere_cloud(20), binning="sharp")


def test_register_takes_the_record():
    record = tr.UniqueShapeContext(radius=0.5)
    assert record.scaled(2).radius == 1.0
    cloud = sphere_cloud(100)
    near = tr.neighbors(cloud, 0.5, 100)
    assert same_bits(record.describe(cloud, near), tr.unique_shape_context(cloud, near))
