"""Frames that are wanted: known poses, control points, level; groups move as a whole."""

from __future__ import annotations

import pytest
import torch
from closeness import close
from determinism import same_bits
from problems import numbers
from refusals import refuses
from rooms import rooms
from sites import made_poses, made_site
from test_control import NORTH, points_of, wrong

import torchreg as tr
from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of
from torchreg.site import place
from torchreg.site.frame import SiteFrame, frame_of, known_poses
from torchreg.site.ups import plumb, up_of_scans

COUNT = 12


def clouds(count):
    """Clouds that say nothing about up."""
    generator = torch.Generator().manual_seed(0)
    return [tr.Clouds(points=torch.randn(40, 3, generator=generator)) for _ in range(count)]


@pytest.fixture(scope="module")
def site():
    return made_site(COUNT, 40, 0.0)


@pytest.fixture(scope="module")
def placement(site):
    return place(site.links, COUNT)


def relative(placement):
    return compose(inverse(placement.T_world_scan[:1]), placement.T_world_scan)


def two_groups():
    site = made_site(COUNT, 66, 0.0)
    apart = [link for link in site.links if (link.target < 5) == (link.source < 5)]
    return site, place(apart, COUNT)


def test_without_a_wish_nothing_changes(placement):
    made = frame_of(placement, SiteFrame(), clouds(COUNT))
    assert same_bits(made.placement.T_world_scan, placement.T_world_scan)
    assert same_bits(made.placement.group, placement.group)
    assert made[1:] == ((), (), ())


def test_a_fixed_scan_has_the_identity_and_relative_poses_stay(placement):
    made = frame_of(placement, SiteFrame(fix=5), clouds(COUNT))
    assert close(made.placement.T_world_scan[5], torch.eye(4).double(), 1e-12)
    assert close(relative(made.placement), relative(placement), 1e-12)
    assert made.placement.in_world.all()
    assert [pose.scan for pose in made.known] == [5]
    sizes = [torch.linalg.eigvalsh(each.covariance) for each in (made.placement, placement)]
    assert close(*sizes, 1e-12)


def test_a_fixed_scan_is_where_its_known_pose_says(placement, site):
    poses = tuple((scan, compose(NORTH, site.poses[scan])) for scan in (2, 5, 7))
    made = frame_of(placement, SiteFrame(fix=5, poses=poses), clouds(COUNT))
    assert close(made.placement.T_world_scan[5], poses[1][1], 1e-6)
    off = (made.placement.T_world_scan - compose(NORTH, site.poses))[:, :3, 3]
    assert off.norm(dim=1).max() < 0.05


def test_known_poses_give_the_frame_together_and_a_wrong_one_is_left_out(placement, site):
    generator = torch.Generator().manual_seed(4)
    truth = compose(NORTH, site.poses)
    poses = []
    for scan in (0, 2, 4, 6, 8, 10):
        T = truth[scan].clone()
        T[:3, 3] += 0.05 * torch.randn(3, generator=generator, dtype=torch.float64)
        poses.append((scan, T))
    alone = frame_of(placement, SiteFrame(poses=tuple(poses[:1])), clouds(COUNT)).placement
    made = frame_of(placement, SiteFrame(poses=tuple(poses)), clouds(COUNT))
    off, off_alone = ((each.T_world_scan - truth)[:, :3, 3].norm(dim=1) for each in (made.placement, alone))
    assert off.mean() < off_alone.mean()
    assert made.remarks == ()

    poses[3][1][0, 3] += 3.0
    made = frame_of(placement, SiteFrame(poses=tuple(poses)), clouds(COUNT))
    assert (made.placement.T_world_scan - truth)[:, :3, 3].norm(dim=1).max() < 0.15
    (remark,) = made.remarks
    assert remark.startswith("the known pose of scan 6 is ")
    assert "m off where the others put it" in remark
    assert [pose.scan for pose in made.known] == [0, 2, 4, 8, 10]


def test_known_poses_tie_scans_before_they_are_placed(site):
    frame = SiteFrame(poses=tuple((scan, compose(NORTH, site.poses[scan])) for scan in (1, 8)), pose_meters=0.01)
    known = known_poses(frame, clouds(COUNT))
    every = made_site(COUNT, 66, 0.0)
    two = place([link for link in every.links if (link.target < 5) == (link.source < 5)], COUNT, known=known)
    assert two.group.tolist() == [0] * COUNT  # groups that no link joins
    made = frame_of(two, frame, clouds(COUNT))
    assert same_bits(made.placement.T_world_scan, two.T_world_scan)
    off = (two.T_world_scan - compose(NORTH, site.poses))[:, :3, 3]
    assert off.norm(dim=1).max() < 0.2


def test_groups_with_enough_points_are_one_in_the_world_and_the_others_stay():
    site, apart = two_groups()
    assert sorted(set(apart.group.tolist())) == [0, 1]
    both = points_of(site.poses, (0, 1, 2, 3, 6, 7, 8, 9))
    made = frame_of(apart, SiteFrame(control=tuple(both)), clouds(COUNT))
    assert made.placement.group.tolist() == [0] * COUNT
    assert made.remarks == ()
    off = (made.placement.T_world_scan - compose(NORTH, site.poses))[:, :3, 3]
    assert off.norm(dim=1).max() < 0.05

    few = frame_of(apart, SiteFrame(control=tuple(both[2:])), clouds(COUNT))
    small = int(apart.group[0])
    assert few.remarks == (f"group {small} has a frame of its own: 2 control points, of 3 that a frame needs",)
    assert few.placement.in_world.tolist() == [False] * 5 + [True] * 7
    assert same_bits(few.placement.T_world_scan[:5], apart.T_world_scan[:5])
    assert [each.meters != each.meters for each in few.points] == [True, True] + [False] * 4
    assert not any(each.suspicious for each in few.points)


def test_a_wrong_point_is_named_with_its_residual(placement, site):
    points = points_of(site.poses, (0, 3, 6, 9, 11), noise=0.002)
    points[2] = wrong(points[2], 1.5)
    made = frame_of(placement, SiteFrame(control=tuple(points)), clouds(COUNT))
    assert [each.suspicious for each in made.points] == [False, False, True, False, False]
    assert abs(made.points[2].meters - 1.5) < 0.1
    assert max(each.meters for each in made.points if not each.suspicious) < 0.05
    assert {pose.scan for pose in made.known} == {0, 3, 9, 11}


def test_points_of_scans_that_are_not_placed_are_named(site):
    some = place([link for link in site.links if 11 not in (link.target, link.source)], COUNT)
    points = points_of(site.poses, (0, 3, 6, 11))
    made = frame_of(some, SiteFrame(control=tuple(points)), clouds(COUNT))
    assert made.remarks == ("control points in scan 11 say nothing: it is not placed",)
    assert made.placement.T_world_scan[11].isnan().all()
    assert made.placement.group[11] == -1


def test_frames_are_level_where_floors_say_so_and_nothing_else_fixes_them():
    made = rooms(2)
    start = place_exactly(made.poses)
    free = frame_of(start, SiteFrame(level=True), made.scans).placement
    up = (free.T_world_scan[:, :3, :3] @ made.poses[:, 2, :3, None])[:, :, 0]
    assert close(up, torch.tensor([0.0, 0.0, 1.0]).double().expand(3, 3), 0.01)
    tilted = frame_of(start, SiteFrame(level=False), made.scans).placement
    assert same_bits(tilted.T_world_scan, start.T_world_scan)
    fixed = frame_of(start, SiteFrame(level=True, fix=1), made.scans).placement
    assert close(fixed.T_world_scan[1], torch.eye(4).double(), 1e-12)


def test_up_is_told_by_scans_alone_and_not_by_noise():
    made = rooms(2)
    up = up_of_scans([*made.scans, *clouds(1)])
    assert ((up[:3] * made.poses[:, 2, :3]).sum(dim=1) > 0.999).all()
    assert up[3].isnan().all()


def test_scanners_that_are_level_themselves_tell_up_better_than_floors():
    poses = made_poses(6)
    lean = rigid(rotation_of(torch.tensor([0.3, 0.1, 0.0]).double()), torch.zeros(3).double())
    rough = torch.nn.functional.normalize(poses[:, 2, :3] + 0.01 * numbers(6, 3), dim=1)
    group = torch.tensor([0, 0, 0, 0, 1, -1])
    up = plumb(rough, compose(lean, poses), group)
    assert up[:4].tolist() == [[0.0, 0.0, 1.0]] * 4
    assert same_bits(up[4:], rough[4:])
    tilted = compose(poses, rigid(rotation_of(0.02 * numbers(6, 3, seed=1)), torch.zeros(6, 3).double()))
    assert same_bits(plumb(rough, compose(lean, tilted), group), rough)


def test_fewer_than_half_of_the_scans_level_nothing():
    made = rooms(3)
    start = place_exactly(made.poses)
    few = [*made.scans[:2], *clouds(3)]
    assert same_bits(frame_of(start, SiteFrame(level=True), few).placement.T_world_scan, start.T_world_scan)


def test_what_does_not_fit_is_refused(placement):
    point = points_of(made_poses(1), (0,))[0]
    with refuses("control", "no control points beside"):
        SiteFrame(fix=0, control=(point,))
    with refuses("fix", "a scan from 0 to 11"):
        frame_of(placement, SiteFrame(fix=12), clouds(COUNT))
    with refuses("control[0].scan", "a scan below 12"):
        frame_of(placement, SiteFrame(control=(point._replace(scan=12),)), clouds(COUNT))
    eye = torch.eye(4).double()
    with refuses("poses", "one pose of a scan"):
        known_poses(SiteFrame(poses=((1, eye), (1, eye))), clouds(COUNT))
    with refuses("scans", "the 12 scans that are placed"):
        frame_of(placement, SiteFrame(), clouds(3))
    with refuses("pose_meters"):
        SiteFrame(pose_meters=0.0)


def place_exactly(poses):
    """Scans placed by exact links of a chain, in a frame that leans as the first scan does."""
    from rooms import Rooms, rough_links

    lean = rigid(rotation_of(torch.tensor([0.05, 0.03, 0.0]).double()), torch.zeros(3).double())
    tilted = compose(lean, poses)
    return place(rough_links(Rooms([], tilted), [(i, i + 1) for i in range(len(poses) - 1)], 1e-4), len(poses))
