"""Keypoints spread evenly: the nearest to the center of every voxel, and the farthest from each other."""

from __future__ import annotations

import itertools

import oracles
import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_points, random_transform, seeded, sphere_cloud
from refusals import refuses

import torchreg as tr


def cloud_of(rows, seed=0, dtype=torch.float64):
    return tr.Clouds(points=random_points(rows, seed, dtype))


def nearest_to_centers(points, size):
    """By a loop over voxels."""
    low = points.amin(dim=0)
    best = {}
    for row, point in enumerate(points):
        cell = torch.floor((point - low) / size + 0.5)
        apart = float((point - low - cell * size).square().sum())
        key = tuple(cell.tolist())
        if key not in best or apart < best[key][0]:
            best[key] = (apart, row)
    return sorted(row for _, row in best.values())


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 60), st.sampled_from([0.1, 0.3, 0.7, 3.0]))
def test_uniform_is_a_plain_loop(seed, rows, size):
    cloud = cloud_of(rows, seed)
    assert tr.uniform_keypoints(cloud, size).rows.tolist() == nearest_to_centers(cloud.points, size)


def test_uniform_has_a_point_of_every_voxel_that_has_any():
    cloud = cloud_of(3000)
    found = tr.uniform_keypoints(cloud, 0.2)
    assert len(found.rows) == len(tr.voxel_downsample(cloud, 0.2).points)


def test_copies_of_a_point_go_to_the_lower_row():
    points = random_points(200, dtype=torch.float64)
    doubled = tr.Clouds(points=torch.cat([points, points]))
    once = tr.uniform_keypoints(tr.Clouds(points=points), 0.3).rows
    assert torch.equal(tr.uniform_keypoints(doubled, 0.3).rows, once)


def test_a_shift_changes_no_row():
    cloud = sphere_cloud(2000)
    moved = tr.Clouds(points=cloud.points + torch.tensor([64.0, -8.0, 2.0]))
    assert torch.equal(tr.uniform_keypoints(cloud, 0.3).rows, tr.uniform_keypoints(moved, 0.3).rows)


def test_farthest_moves_with_the_cloud():
    cloud = sphere_cloud(2000)
    moved = tr.transform(cloud, random_transform(seeded(2)))
    assert torch.equal(tr.farthest_keypoints(cloud, 50).rows, tr.farthest_keypoints(moved, 50).rows)


def test_farthest_is_a_plain_loop_and_the_points_of_the_downsampling():
    cloud = cloud_of(300)
    found = tr.farthest_keypoints(cloud, 40)
    assert found.rows.tolist() == sorted(oracles.farthest_points(cloud.points, 40))
    kept = tr.farthest_point_downsample(cloud, 40)
    assert sorted(kept.points.tolist()) == sorted(cloud.points[found.rows].tolist())


@pytest.mark.parametrize("select", [lambda cloud: tr.uniform_keypoints(cloud, 0.2), lambda cloud: tr.farthest_keypoints(
    cloud, 30)])  # fmt: skip
def test_a_batch_equals_the_loop_and_threads_change_nothing(select):
    clouds = [cloud_of(rows, rows, torch.float32) for rows in (900, 0, 1, 9000, 7)]
    alone = [select(cloud) for cloud in clouds]
    batch = tr.Clouds.pack(clouds)
    expected = torch.cat([one.rows + begin for one, begin in zip(alone, batch.offsets.tolist(), strict=False)])
    for number in THREADS:
        with threads(number):
            found = select(batch)
        assert same_bits(found.rows, expected)
        assert found.offsets.tolist() == [0, *itertools.accumulate(len(one.rows) for one in alone)]


def test_voxels_may_differ_by_cloud():
    clouds = [cloud_of(500, 1), cloud_of(500, 2)]
    found = tr.uniform_keypoints(tr.Clouds.pack(clouds), torch.tensor([0.2, 0.5]))
    alone = [tr.uniform_keypoints(cloud, size) for cloud, size in zip(clouds, (0.2, 0.5), strict=True)]
    assert torch.equal(found.rows, torch.cat([alone[0].rows, 500 + alone[1].rows]))


def test_what_does_not_fit_is_refused():
    cloud = cloud_of(10)
    with refuses("voxel_size"):
        tr.uniform_keypoints(cloud, 0.0)
    with refuses("voxel_size", "at most 2^62 voxels"):
        tr.uniform_keypoints(cloud, 1e-30)
    with refuses("count"):
        tr.farthest_keypoints(cloud, 0)
    with refuses("count"):
        tr.FarthestKeypoints(count=0)
    with refuses("voxel_size"):
        tr.UniformKeypoints(voxel_size=-1.0)


def test_keypoints_are_those_of_features():
    cloud = cloud_of(100)
    found = tr.uniform_keypoints(cloud, 0.3)
    values = torch.rand(100, 4)
    some = tr.KeypointFeatures(found.rows, values[found.rows])
    result = tr.register_features(cloud, cloud, some, some, tr.options_for(0.2), effort="plain")
    assert set(result.correspondences.source.tolist()) <= set(found.rows.tolist())
