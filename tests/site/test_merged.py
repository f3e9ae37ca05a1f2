"""Scans of a group as one cloud."""

from dataclasses import replace

import pytest
import torch
from problems import random_points, turned

import torchreg as tr
from torchreg.geometry.se3 import inverse
from torchreg.site import SiteResult
from torchreg.site.merged import merged_cloud

SPACING = 0.05


def placed(poses, group):
    """A result with these poses and no links."""
    count = len(group)
    return SiteResult(
        T_world_scan=torch.stack(poses),
        group=torch.tensor(group),
        covariance=torch.zeros(count, 6, 6, dtype=torch.float64),
        center=torch.zeros(count, 3, dtype=torch.float64),
        reason=("",) * count,
        notes=((),) * count,
        links=(),
        pairs=(),
        scale=1.0,
        doubt=0.0,
        seconds=(),
    )


def test_moved_copies_fall_on_each_other():
    world = tr.Clouds(random_points(3000), colors=random_points(3000, seed=1))
    poses = [turned(0), turned(70, (1, 2, 3), (4, -5, 6)), turned(200, (0, 1, 1), (5e5, 4e6, 100))]
    scans = [tr.transform(world, inverse(T)) for T in poses]
    merged = merged_cloud(scans, placed(poses, [0, 0, 0]), spacing=SPACING)
    alone = merged_cloud(scans[:1], placed(poses[:1], [0]), spacing=SPACING)
    places = merged.points.double() + merged.origin
    assert len(merged.points) < 1.5 * len(alone.points)  # three copies, no more cubes but at their edges
    assert float(places.amin()) > -0.001
    assert float(places.amax()) < 1.001
    assert merged.colors is not None


def test_one_group_alone_and_gray_beside_colors():
    cloud = tr.Clouds(random_points(100), colors=torch.ones(100, 3))
    bare = tr.Clouds(random_points(100) + 5)
    site = placed([turned(0)] * 3, [0, 0, 1])
    merged = merged_cloud([cloud, bare, bare], site, spacing=SPACING)
    near = merged.points[:, 0] < 2
    assert bool((merged.colors[near] == 1).all())
    assert bool((merged.colors[~near] == 0.5).all())
    assert merged_cloud([cloud, bare, bare], site, spacing=SPACING, group=1).colors is None


def test_arguments_are_checked():
    cloud = tr.Clouds(random_points(100))
    site = placed([turned(0)], [0])
    with pytest.raises(ValueError, match="spacing"):
        merged_cloud([cloud], site, spacing=0.0)
    with pytest.raises(ValueError, match="group: expected one of 1 groups, got 1"):
        merged_cloud([cloud], site, spacing=0.1, group=1)
    with pytest.raises(ValueError, match="scans: expected the 1 scans of the site"):
        merged_cloud([cloud] * 2, replace(site), spacing=0.1)
