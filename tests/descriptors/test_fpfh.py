"""FPFH against plain loops, its invariances, and that nothing but the neighborhood shows."""

import oracles
import pytest
import torch
from closeness import close
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import oriented_room, random_transform, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.fpfh import simplified_histograms


def bare(values, normals=None, offsets=None):
    return tr.Clouds(points=values, normals=normals, offsets=offsets)


@pytest.mark.parametrize("mode", ["open3d", "pcl"])
@pytest.mark.parametrize("seed", range(3))
def test_values_are_those_of_plain_loops(mode, seed):
    cloud = sphere_cloud(120, seed=seed)
    near = tr.neighbors(cloud, 0.9, 25)
    found = tr.fpfh(cloud, near, mode=mode)
    expected = oracles.fpfh(cloud.points, cloud.normals, near, own=mode == "open3d")
    assert found.blocks == (("fpfh", 33),)
    assert close(found.values, expected, atol=1e-9)


def test_values_in_float32_are_close_to_those_in_float64():
    cloud = sphere_cloud(400)
    narrow = cloud.to(dtype=torch.float32)
    wide = tr.fpfh(cloud, tr.neighbors(cloud, 0.5, 30)).values
    found = tr.fpfh(narrow, tr.neighbors(narrow, 0.5, 30)).values
    assert found.dtype == torch.float32
    # but for a few votes at the edges of bins
    assert ((found - wide).abs() > 1e-3).float().mean() < 0.01


@pytest.mark.parametrize(("mode", "block"), [("open3d", 200), ("pcl", 100)])
def test_every_block_of_a_valid_row_has_its_sum(mode, block):
    cloud, near = oriented_room()
    features = tr.fpfh(cloud, near, mode=mode)
    sums = features.values.view(-1, 3, 11).sum(dim=2)
    assert torch.allclose(sums[features.valid], torch.tensor(float(block)), rtol=1e-5)
    assert not features.values[~features.valid].any()


def test_simplified_histograms_are_percents_of_whole_votes():
    cloud = sphere_cloud(120)
    near = tr.neighbors(cloud, 0.9, 25)
    spfh = simplified_histograms(cloud.points, cloud.normals, near)
    votes = spfh * (near.counts() - 1)[:, None] / 100
    assert close(votes, votes.round(), atol=1e-12)
    assert close(spfh, oracles.spfh(cloud.points, cloud.normals, near), atol=1e-9)


def test_a_point_without_neighbors_is_not_valid():
    points = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [9.0, 9, 9]])
    cloud = bare(points, torch.tensor([[0.0, 0, 1]] * 3))
    features = tr.fpfh(cloud, tr.neighbors(cloud, 1.0, 5))
    assert features.valid.tolist() == [True, True, False]
    assert features.values[2].tolist() == [0] * 33


def test_duplicates_of_a_point_vote_but_weigh_nothing():
    cloud = sphere_cloud(30)
    twice = bare(cloud.points.repeat(2, 1), cloud.normals.repeat(2, 1))
    near = tr.neighbors(twice, 1.0, 20)
    found = tr.fpfh(twice, near)
    assert torch.isfinite(found.values).all()
    assert close(found.values, oracles.fpfh(twice.points, twice.normals, near), atol=1e-9)


@pytest.mark.parametrize("gap", [1e-15, 1e-18, 1e-19, 1e-20, 1e-22])
def test_points_almost_in_one_place_stay_finite(gap):
    generator = torch.Generator().manual_seed(0)
    points = torch.cat([torch.rand(10, 3, generator=generator), torch.zeros(1, 3), torch.tensor([[gap, 0.0, 0.0]])])
    normals = torch.nn.functional.normalize(torch.rand(12, 3, generator=generator), dim=1)
    cloud = bare(points, normals)
    values = tr.fpfh(cloud, tr.neighbors(cloud, 2.0, 12)).values
    assert torch.isfinite(values).all()
    assert torch.allclose(values.sum(dim=1), torch.tensor(600.0), rtol=1e-4)


@settings(max_examples=20)
@given(st.integers(0, 2**31))
def test_a_rigid_motion_changes_nothing(seed):
    cloud = sphere_cloud(150, seed=seed)
    near = tr.neighbors(cloud, 0.6, 30)
    moved = tr.transform(cloud, random_transform(torch.Generator().manual_seed(seed)))
    moved = bare(moved.points + moved.origin, moved.normals)
    found, expected = tr.fpfh(moved, near).values, tr.fpfh(cloud, near).values
    # a vote at the edge of a bin may fall to the other side; in float64 hardly one does
    assert ((found - expected).abs() > 1e-6).float().mean() < 1e-3


def test_mirrored_geometry_is_told_apart():
    cloud = sphere_cloud(150)
    mirror = torch.tensor([1.0, 1, -1], dtype=torch.float64)
    mirrored = bare(cloud.points * mirror, cloud.normals * mirror)
    near = tr.neighbors(cloud, 0.6, 30)
    assert not close(tr.fpfh(cloud, near).values, tr.fpfh(mirrored, near).values, atol=1.0)


def test_an_empty_cloud_has_no_rows():
    empty = bare(torch.zeros(0, 3), torch.zeros(0, 3))
    features = tr.fpfh(empty, tr.neighbors(empty, 1.0, 5))
    assert features.values.shape == (0, 33)


def test_what_does_not_fit_is_refused():
    cloud, near = oriented_room(100)
    with refuses("mode", "'open3d', 'pcl'", "'vtk'"):
        tr.fpfh(cloud, near, mode="vtk")
    with refuses("binning", "'hard', 'soft'", "'firm'"):
        tr.fpfh(cloud, near, binning="firm")
    with refuses("cloud", "normals", "none"):
        tr.fpfh(bare(cloud.points), near)
    with refuses("near", "2", str(len(near))):
        tr.fpfh(cloud.rows(torch.arange(2), torch.tensor([0, 2])), near)
