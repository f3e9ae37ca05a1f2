"""Leveled frames: z is up where most scans say so, and nothing else changes."""

import math

import pytest
import torch
from closeness import close
from determinism import same_bits
from problems import numbers, seeded, turned
from refusals import refuses
from sites import made_poses, made_site, right_link

from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of
from torchreg.site import KnownPose, loose_covariance, place
from torchreg.site.level import level

Z = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


def tilted_site(count=12, pairs=40):
    """Scanners that stand as they like, and up in the frame of each."""
    poses = compose(made_poses(count), rigid(rotation_of(numbers(count, 3)), torch.zeros(count, 3).double()))
    site = made_site(count, pairs, 0.0)
    generator = seeded()
    links = [right_link(poses, (one.target, one.source), generator) for one in site.links]
    return links, poses[:, 2, :3].clone()  # R^T z


def ups(placement, up):
    return (placement.T_world_scan[:, :3, :3] @ up[:, :, None])[:, :, 0]


def test_up_is_z_and_relative_poses_stay():
    links, up = tilted_site()
    before = place(links, 12)
    after = level(before, 3 * up)
    assert close(ups(after, up), Z.expand(12, 3), math.radians(0.5))
    relative = [compose(inverse(each.T_world_scan[:1]), each.T_world_scan) for each in (before, after)]
    assert close(*relative, 1e-12)
    assert close(after.T_world_scan[0, :3, 3], torch.zeros(3).double(), 0)
    sizes = [torch.linalg.eigvalsh(each.covariance) for each in (before, after)]
    assert close(*sizes, 1e-12)


def test_a_few_wrong_votes_change_little_and_unknown_ones_nothing():
    links, up = tilted_site()
    before = place(links, 12)
    some = up.clone()
    some[[2, 5, 9]] = -up[[2, 5, 9]]
    some[7] = torch.nan
    some[8] = 0
    assert close(ups(level(before, some), up), Z.expand(12, 3), math.radians(0.5))


@pytest.mark.parametrize("votes", ["none", "all apart"])
def test_without_a_majority_the_frame_stays(votes):
    links, up = tilted_site()
    before = place(links, 12)
    some = torch.full_like(up, torch.nan) if votes == "none" else numbers(12, 3)
    assert same_bits(level(before, some).T_world_scan, before.T_world_scan)


def test_a_frame_upside_down_is_turned():
    links, up = tilted_site()
    before = level(place(links, 12), -up)
    exact = torch.zeros(12, 3).double()
    exact[:] = -before.T_world_scan[:, 2, :3]
    assert close(ups(level(before, exact), exact), Z.expand(12, 3), 1e-9)


def test_the_frame_of_known_poses_stays():
    links, up = tilted_site()
    known = KnownPose(scan=0, T_world_scan=turned(40, (1, 0, 0)), covariance=loose_covariance(0.01, 5.0))
    before = place(links, 12, known=[known])
    assert same_bits(level(before, up).T_world_scan, before.T_world_scan)


def test_scans_that_are_not_placed_stay_so():
    links, up = tilted_site()
    after = level(place(links, 13), torch.cat([up, up[:1]]))
    assert bool(after.T_world_scan[12].isnan().all())
    assert close(ups(after, torch.cat([up, up[:1]]))[:12], Z.expand(12, 3), math.radians(0.5))


def test_another_shape_is_refused():
    with refuses("up", "(3, 3)", "(2, 3)"):
        level(place([], 3), torch.zeros(2, 3, dtype=torch.float64))
