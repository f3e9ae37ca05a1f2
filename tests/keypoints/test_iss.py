"""Intrinsic shape signatures: Open3D's points but for ties, and what must not change them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from determinism import assert_nothing_shows, same_bits
from problems import garbage_in_invalid_slots, plane_cloud, random_transform, room_pair, seeded, sphere_cloud
from refusals import refuses
from stages import moved
from stand_in import NAME, StandIn

import torchreg as tr
from torchreg.keypoints.iss import _salience
from torchreg.keypoints.keypoints import rows_where
from torchreg.open3d_loader import load_open3d

REAL = Path(__file__).parents[3] / "shared" / "data" / "real"
TIED = 1e-9  # relative


def iss(cloud, radius, non_max_radius, **words):
    near = tr.neighbors(cloud, radius, 1000).trimmed()
    return tr.iss_keypoints(cloud, near, non_max_radius, **words)


def open3d_rows(cloud, radius, non_max_radius):
    """Rows that Open3D selects, found again by their coordinates."""
    given = tr.to_open3d(cloud)
    found = load_open3d().geometry.keypoint.compute_iss_keypoints(given, radius, non_max_radius)
    row = {tuple(point): number for number, point in enumerate(np.asarray(given.points).tolist())}
    return {row[tuple(point)] for point in np.asarray(found.points).tolist()}


def assert_those_of_open3d(cloud, radius, non_max_radius):
    """The same rows, but that points equally salient within the radius of suppression may stand for each other."""
    near = tr.neighbors(cloud, radius, 1000).trimmed()
    salience = _salience(cloud.points, near, 0.975, 0.975, 5)
    ours, theirs = set(iss(cloud, radius, non_max_radius).rows.tolist()), open3d_rows(cloud, radius, non_max_radius)
    assert len(ours) > 5

    def tied(row, others):
        apart = torch.cdist(cloud.points[[row]], cloud.points[others])[0]
        equal = (salience[others] - salience[row]).abs() <= TIED * salience[row]
        return bool((equal & (apart < radius)).any())

    for one, other in ((ours, theirs), (theirs, ours)):
        assert all(tied(row, sorted(other)) for row in one - other)
    return ours ^ theirs


@pytest.mark.parametrize("radius", [0.2, 0.3, 0.5])
def test_rows_are_those_of_open3d(radius):
    cloud = sphere_cloud(4000, seed=2)
    assert assert_those_of_open3d(cloud, radius, 0.6 * radius) == set()


def test_rows_are_those_of_open3d_in_a_room():
    cloud = tr.voxel_downsample(room_pair(12_000, noise=0.01, dtype=torch.float64).source, 0.1)
    assert_those_of_open3d(cloud, 0.6, 0.4)


@pytest.mark.real
@pytest.mark.skipif(not REAL.exists(), reason="no real pairs beside the checkout")
@pytest.mark.parametrize("number", [0, 14, 22, 30, 36])
def test_rows_are_those_of_open3d_on_real_scans(number):
    pair = json.loads((REAL / "pairs.json").read_text())["pairs"][number]
    cloud = tr.read_cloud(REAL / pair["source"], dtype=torch.float64)
    voxel = pair["voxel_m"]
    cloud = tr.voxel_downsample(cloud, voxel)
    cloud = tr.Clouds(points=cloud.points - cloud.points.mean(dim=0))  # Open3D sums squares about zero
    assert_those_of_open3d(cloud, 6 * voxel, 4 * voxel)


def test_other_ratios_select_what_the_definition_says():
    cloud, radius, smaller = sphere_cloud(600, seed=1), 0.5, 0.3
    points = cloud.points.numpy()
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    third = np.zeros(len(points))
    for row, distances in enumerate(apart):
        around = points[distances < radius]
        e3, e2, e1 = np.linalg.eigvalsh(np.cov(around.T, bias=True))
        third[row] = e3 if e2 / e1 < 0.8 and e3 / e2 < 0.1 and len(around) >= 12 else 0.0
    around, row = apart < smaller, np.arange(len(points))
    more = third > third[:, None] * (1 + TIED)
    first = (third >= third[:, None] * (1 - TIED)) & (row < row[:, None])  # of equals
    beaten = (around & (more | first)).any(axis=1)
    expected = np.nonzero((third > 0) & ~beaten & (around.sum(axis=1) >= 12))[0]
    found = iss(cloud, radius, smaller, gamma_21=0.8, gamma_32=0.1, min_neighbors=12)
    assert 0 < len(expected) < len(iss(cloud, radius, smaller).rows)
    assert found.rows.tolist() == expected.tolist()


def test_a_rigid_motion_and_a_scale_change_nothing():
    cloud = sphere_cloud(2000, seed=3)
    rows = iss(cloud, 0.3, 0.2).rows
    moved = tr.transform(cloud, random_transform(seeded(1)))
    assert torch.equal(iss(moved, 0.3, 0.2).rows, rows)
    larger = tr.Clouds(points=7 * cloud.points)
    assert torch.equal(iss(larger, 2.1, 1.4).rows, rows)


def saliences(cloud, radius, found):
    """Of the points found, ascending; equal ones stand for each other where their rows are exchanged."""
    near = tr.neighbors(cloud, radius, 1000).trimmed()
    return _salience(cloud.points, near, 0.975, 0.975, 5)[found.rows].sort().values


def test_the_order_of_the_points_does_not_matter():
    cloud = sphere_cloud(1500, seed=4)
    other = tr.Clouds(points=cloud.points[torch.randperm(1500, generator=seeded(5))])
    one, another = (saliences(each, 0.3, iss(each, 0.3, 0.2)) for each in (cloud, other))
    assert len(one) > 30
    assert torch.allclose(one, another, rtol=TIED)


def test_copies_of_a_point_are_selected_once():
    cloud = sphere_cloud(1500, seed=5)
    doubled = tr.Clouds(points=torch.cat([cloud.points, cloud.points]))
    one, another = (saliences(each, 0.5, iss(each, 0.5, 0.4)) for each in (cloud, doubled))
    assert len(one) > 10
    assert torch.allclose(one, another, rtol=TIED)


def test_a_batch_equals_the_loop_and_radii_may_differ_by_point():
    clouds = [sphere_cloud(count, seed=count) for count in (700, 1, 400, 900)]
    empty = clouds[0].rows(torch.zeros(0, dtype=torch.int64), torch.tensor([0, 0]))
    clouds.insert(2, empty)
    batch = tr.Clouds.pack(clouds)
    radii = [0.3, 0.3, 0.3, 0.4, 0.5]
    near = tr.neighbors(batch, torch.tensor(radii, dtype=torch.float64), 400)
    suppression = torch.tensor(radii).repeat_interleave(torch.tensor(batch.lengths)) / 2
    found = tr.iss_keypoints(batch, near, suppression)
    alone = [iss(cloud, radius, radius / 2).rows for cloud, radius in zip(clouds, radii, strict=True)]
    assert found.offsets.diff().tolist() == [len(rows) for rows in alone]
    expected = [rows + begin for rows, begin in zip(alone, batch.offsets.tolist(), strict=False)]
    assert torch.equal(found.rows, torch.cat(expected))
    assert batch.rows(*found).lengths == [len(rows) for rows in alone]


def test_threads_and_chunks_change_nothing():
    cloud = sphere_cloud(1500)
    near = tr.neighbors(cloud, 0.3, 60)
    assert_nothing_shows(lambda: tr.iss_keypoints(cloud, near, 0.2))


@pytest.mark.parametrize("kernels", [True, False])
def test_kernels_do_not_show(kernels):
    cloud = sphere_cloud(1000)
    near = tr.neighbors(cloud, 0.3, 200)
    with tr.native_kernels(kernels):
        assert same_bits(tr.iss_keypoints(cloud, near, 0.2).rows, iss(cloud, 0.3, 0.2).rows)


def tilted_plane(count):
    plane = plane_cloud(count, 2.0)
    return tr.transform(plane, random_transform(seeded(3)))


LINE = tr.Clouds(points=torch.linspace(0, 1, 50)[:, None] * torch.tensor([1.0, 2.0, 3.0]))
DEGENERATE = {
    "nothing": tr.Clouds(points=torch.zeros(0, 3)),
    "a point": tr.Clouds(points=torch.ones(1, 3)),
    "four points": tr.Clouds(points=torch.eye(4)[:, :3]),
    "one place": tr.Clouds(points=torch.ones(30, 3)),
    "a line": LINE,
    "a plane": plane_cloud(500, 2.0),
    "a tilted plane": tilted_plane(500),
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_clouds_have_no_keypoints(name):
    cloud = DEGENERATE[name]
    found = iss(cloud, 0.5, 0.3)
    assert found.rows.shape == (0,)
    assert found.offsets.tolist() == [0, 0]


def test_garbage_in_invalid_slots_changes_nothing():
    cloud = sphere_cloud(900)
    near = tr.neighbors(cloud, 0.3, 300)
    found = tr.iss_keypoints(cloud, garbage_in_invalid_slots(near), 0.2)
    assert torch.equal(found.rows, tr.iss_keypoints(cloud, near, 0.2).rows)


def test_what_does_not_fit_is_refused():
    cloud = sphere_cloud(50)
    near = tr.neighbors(cloud, 0.3, 20)
    with refuses("non_max_radius", "at most the radius of near (0.3)"):
        tr.iss_keypoints(cloud, near, 0.4)
    with refuses("non_max_radius", "one per point"):
        tr.iss_keypoints(cloud, near, torch.ones(3))
    with refuses("non_max_radius", "at most the radius, 1.0 m"):
        tr.IssKeypoints(radius=1.0, non_max_radius=1.5)
    with refuses("near", "neighborhoods of 50 points"):
        tr.iss_keypoints(cloud, tr.neighbors(sphere_cloud(49), 0.3, 20), 0.2)
    for name in ("gamma_21", "gamma_32"):
        with refuses(name):
            tr.iss_keypoints(cloud, near, 0.2, **{name: 0.0})


def test_rows_where_counts_by_cloud():
    cloud = tr.Clouds(points=torch.zeros(4, 3), offsets=torch.tensor([0, 1, 1, 4]))
    found = rows_where(cloud, torch.tensor([True, False, True, True]))
    assert found.rows.tolist() == [0, 2, 3]
    assert found.offsets.tolist() == [0, 1, 1, 3]


def copied_sizes(run):
    """How many numbers each copy from the stand-in to the CPU holds."""
    sizes = []

    class Watched(StandIn):
        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            before = self.transfers["_to_copy"]
            result = super().__torch_dispatch__(func, types, args, kwargs)
            if self.transfers["_to_copy"] > before:
                sizes.append(result.numel())
            return result

    with Watched():
        run()
    return sizes


def test_the_host_reads_a_number_per_cloud_and_none_per_point():
    cloud = tr.Clouds(points=sphere_cloud(400).points, offsets=torch.tensor([0, 150, 400]))
    radii = torch.full((400,), 0.5)
    near = tr.neighbors(cloud, 0.5, 20)
    near = tr.Neighborhoods(near.index, near.valid, near.sq_distance, radii)

    def run():
        there = moved(cloud, NAME)
        tr.iss_keypoints(there, moved(near, NAME), (0.5 * radii).to(NAME))

    assert 3 in copied_sizes(run)
    assert max(copied_sizes(run)) <= 3
