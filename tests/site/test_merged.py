"""Scans of a group as one cloud."""

import gc
import weakref
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from problems import random_points, turned
from sites import site_of_poses

import torchreg as tr
from torchreg.geometry.se3 import apply, inverse
from torchreg.site.merged import merged_cloud

SPACING = 0.05


def placed(poses, group):
    return site_of_poses(torch.stack(poses), group)


def test_moved_copies_fall_on_each_other():
    world = tr.Clouds(random_points(3000), colors=random_points(3000, seed=1))
    poses = [turned(0), turned(70, (1, 2, 3), (4, -5, 6)), turned(200, (0, 1, 1), (5e5, 4e6, 100))]
    scans = [tr.transform(world, inverse(T)) for T in poses]
    merged = merged_cloud(scans, placed(poses, [0, 0, 0]), spacing=SPACING).cloud
    alone = merged_cloud(scans[:1], placed(poses[:1], [0]), spacing=SPACING).cloud
    places = merged.points.double() + merged.origin
    assert len(merged.points) < 1.5 * len(alone.points)  # three copies, no more cubes but at their edges
    assert float(places.amin()) > -0.001
    assert float(places.amax()) < 1.001
    assert merged.colors is not None


def test_one_group_alone_and_gray_beside_colors():
    cloud = tr.Clouds(random_points(100), colors=torch.ones(100, 3))
    bare = tr.Clouds(random_points(100) + 5)
    site = placed([turned(0)] * 3, [0, 0, 1])
    merged = merged_cloud([cloud, bare, bare], site, spacing=SPACING).cloud
    near = merged.points[:, 0] < 2
    assert bool((merged.colors[near] == 1).all())
    assert bool((merged.colors[~near] == 0.5).all())
    assert merged_cloud([cloud, bare, bare], site, spacing=SPACING, group=1).cloud.colors is None


def by_cubes(scans, poses, spacing):
    """The plain way: every point looked up in a dictionary of cubes; means, and the scan with most points."""
    anchor = np.floor(np.median((scans[0].points.double() + scans[0].origin).numpy(), axis=0) / spacing) * spacing
    cubes = {}
    for number, (scan, T) in enumerate(zip(scans, poses, strict=True)):
        for point in apply(T, scan.points.double() + scan.origin).numpy():
            cubes.setdefault(tuple(np.floor((point - anchor) / spacing)), []).append((point, number))
    means = {}
    for points in cubes.values():
        numbers = [number for _, number in points]
        most = max(sorted(set(numbers)), key=numbers.count)
        means[tuple(np.round(np.mean([point for point, _ in points], axis=0), 4))] = most
    return means


@pytest.mark.parametrize("rows", [1, 100, 10**6])
def test_every_cube_is_one_point_of_the_scan_that_has_most_in_it(monkeypatch, rows):
    monkeypatch.setattr("torchreg.site.merged._MERGE_ROWS", rows)
    scans = [tr.Clouds(random_points(400 + 100 * seed, seed)) for seed in range(4)]
    poses = [turned(0), *(turned(20 * seed, (1, 2, 3), (0.1, 0, 0.2)) for seed in range(1, 4))]
    merged = merged_cloud(scans, placed(poses, [0] * 4), spacing=0.15)
    expected = by_cubes(scans, poses, 0.15)
    assert len(merged.cloud.points) == len(expected)
    found = {
        tuple(np.round(p, 4)): s
        for p, s in zip(merged.cloud.points.double().numpy(), merged.scan.tolist(), strict=True)
    }
    near = sum(found.get(point) == scan for point, scan in expected.items())
    assert near > 0.98 * len(expected)  # the others are rounded to another fourth digit


def test_memory_is_for_one_scan_at_a_time():
    alive = []

    class Scans(Sequence):
        def __len__(self):
            return 6

        def __getitem__(self, which):
            gc.collect()
            assert sum(one() is not None for one in alive) <= 1
            cloud = tr.Clouds(random_points(200, which))
            alive.append(weakref.ref(cloud))
            return cloud

    merged = merged_cloud(Scans(), placed([turned(0)] * 6, [0] * 6), spacing=SPACING)
    assert set(merged.scan.tolist()) == set(range(6))
    assert len(alive) == 6


def test_colored_points_give_the_color_of_a_cube():
    red = torch.tensor([1.0, 0.0, 0.0]).expand(100, 3)
    cloud = tr.Clouds(random_points(100), colors=red.contiguous())
    merged = merged_cloud([tr.Clouds(cloud.points), cloud], placed([turned(0)] * 2, [0, 0]), spacing=0.5).cloud
    assert torch.equal(merged.colors, red[: len(merged.colors)])


def test_arguments_are_checked():
    cloud = tr.Clouds(random_points(100))
    site = placed([turned(0)], [0])
    with pytest.raises(ValueError, match="spacing"):
        merged_cloud([cloud], site, spacing=0.0)
    with pytest.raises(ValueError, match="spacing: expected at least"):
        merged_cloud([cloud], site, spacing=1e-7)
    with pytest.raises(ValueError, match="group: expected one of 1 groups, got 1"):
        merged_cloud([cloud], site, spacing=0.1, group=1)
    with pytest.raises(ValueError, match="scans: expected the 1 scans of the site"):
        merged_cloud([cloud] * 2, replace(site), spacing=0.1)
