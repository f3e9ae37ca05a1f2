"""Control points give the frame of the world, and one that is wrong does not spoil it."""

from __future__ import annotations

import math

import pytest
import torch
from closeness import close
from problems import seeded
from refusals import refuses
from sites import made_poses, made_site

from torchreg.errors import CloudFileError
from torchreg.geometry.se3 import apply, compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of
from torchreg.io.scan_table import scan_number
from torchreg.site import place
from torchreg.site.control import (
    ControlPoint,
    control_frame,
    poses_of_points,
    read_control_points,
)

NORTH = rigid(rotation_of(torch.tensor([0.1, -0.2, 2.0]).double()), torch.tensor([4.5e5, 5.4e6, 310.0]).double())
HEADER = "name,scan,x,y,z,X,Y,Z\n"


def points_of(poses, scans, *, noise=0.0, seed=0, motion=NORTH):
    """One control point for each scan named, some meters from its scanner."""
    generator = seeded(seed)
    result = []
    for number, scan in enumerate(scans):
        here = 6 * torch.rand(3, generator=generator, dtype=torch.float64) - 3
        there = apply(compose(motion, poses[scan]), here[None])[0]
        there = there + noise * torch.randn(3, generator=generator, dtype=torch.float64)
        result.append(ControlPoint(f"P{number}", scan, tuple(here.tolist()), tuple(there.tolist())))
    return result


def wrong(point, by):
    x, y, z = point.world
    return point._replace(world=(x + by, y, z))


@pytest.mark.parametrize("scans", [(0, 0, 0), (0, 3, 7), (2, 2, 5, 6, 9)])
def test_exact_points_give_the_exact_frame(scans):
    poses = made_poses(10)
    made = control_frame(points_of(poses, scans), poses, [0.05] * len(scans))
    assert made.reason == ""
    assert made.agreeing == tuple(range(len(scans)))
    assert close(made.T_world_group[:3, :3], NORTH[:3, :3], 1e-9)
    assert close(compose(made.T_world_group, poses)[:, :3, 3], compose(NORTH, poses)[:, :3, 3], 1e-6)


@pytest.mark.parametrize("by", [0.3, 5.0, 1e4])
@pytest.mark.parametrize("bad", range(5))
def test_one_wrong_point_of_five_changes_nothing(bad, by):
    poses = made_poses(10)
    points = points_of(poses, (0, 2, 4, 6, 8), noise=0.003)
    alone = control_frame([point for place, point in enumerate(points) if place != bad], poses, [0.05] * 4)
    points[bad] = wrong(points[bad], by)
    made = control_frame(points, poses, [0.05] * 5)
    assert made.agreeing == tuple(place for place in range(5) if place != bad)
    assert close(compose(made.T_world_group, poses)[:, :3, 3], compose(alone.T_world_group, poses)[:, :3, 3], 1e-6)


def test_the_order_of_points_does_not_matter():
    poses = made_poses(10)
    points = points_of(poses, (0, 2, 4, 6, 8, 1, 3), noise=0.01)
    points[3] = wrong(points[3], 1.0)
    made = [control_frame(each, poses, [0.06] * 7).T_world_group for each in (points, points[::-1])]
    assert close(*(compose(T, poses)[:, :3, 3] for T in made), 1e-6)


def test_too_few_points_points_on_a_line_and_points_that_contradict_have_reasons():
    poses = made_poses(10)
    points = points_of(poses, (0, 3, 7))
    assert control_frame(points[:2], poses, [0.05] * 2).reason == "2 control points, of 3 that a frame needs"
    spread = [points[0]._replace(place=(x, 0.0, 0.0), world=(x, 5.0, 0.0)) for x in (0.0, 2.0, 7.0)]
    assert control_frame(spread, poses, [0.05] * 3).reason == "its control points lie on a line"
    apart = [points[0], points[1], wrong(points[2], 9.0)]
    assert control_frame(apart, poses, [0.05] * 3).reason == "its control points contradict each other"
    assert control_frame(apart, poses, [0.05] * 3).T_world_group is None


def test_many_points_take_no_longer_than_some():
    poses = made_poses(10)
    points = points_of(poses, [scan % 10 for scan in range(60)], noise=0.003)
    for bad in (3, 10, 20, 40):
        points[bad] = wrong(points[bad], 2.0)
    made = control_frame(points, poses, [0.05] * 60)
    assert len(made.agreeing) == 56
    assert close(compose(made.T_world_group, poses)[:, :3, 3], compose(NORTH, poses)[:, :3, 3], 0.01)


def test_poses_of_points_are_known_where_points_hold_them():
    poses = made_poses(10)
    points = points_of(poses, (0, 0, 0, 4))
    off = rigid(rotation_of(torch.tensor([0.0, 0.0, 0.002]).double()), torch.tensor([0.02, 0.0, 0.01]).double())
    start = compose(compose(NORTH, off), poses)
    three, one = poses_of_points(points, start)
    assert [three.scan, one.scan] == [0, 4]
    assert close(three.T_world_scan[:3, 3], compose(NORTH, poses)[0, :3, 3], 0.001)
    assert three.covariance.diagonal()[3:].sqrt().max() < 0.01
    # one point holds its place and no turn
    here = torch.tensor([points[3].place], dtype=torch.float64)
    assert close(apply(one.T_world_scan, here)[0], torch.tensor(points[3].world, dtype=torch.float64), 1e-4)
    assert one.covariance.diagonal()[:3].sqrt().min() > 0.2


def test_links_and_points_of_different_scans_settle_together():
    site = made_site(12, 40, 0.0)
    points = points_of(site.poses, (0, 3, 6, 9, 11))
    before = place(site.links, 12)
    frame = control_frame(points, before.T_world_scan, [0.1] * 5).T_world_group
    known = poses_of_points(points, compose(frame, before.T_world_scan))
    after = place(site.links, 12, known=known)
    assert after.in_world.all()
    errors = [
        (compose(T, each)[:, :3, 3] - compose(NORTH, site.poses)[:, :3, 3]).norm(dim=1)
        for T, each in ((frame, before.T_world_scan), (torch.eye(4).double(), after.T_world_scan))
    ]
    assert errors[1].max() < 0.02
    assert errors[1].square().mean() <= 1.2 * errors[0].square().mean()


def test_a_table_is_read_by_names_and_numbers(tmp_path):
    table = tmp_path / "points.csv"
    table.write_text(HEADER + "A,b.ply,1,2,3,10,20,30\nB,0,4,5,6,40,50,60\n\nC,p.e57 [1],0,0,0,1,1,1\n")
    names = ["scans/a.ply", "scans/b.ply", "p.e57 [1]"]
    assert read_control_points(table, names) == [
        ControlPoint("A", 1, (1.0, 2.0, 3.0), (10.0, 20.0, 30.0)),
        ControlPoint("B", 0, (4.0, 5.0, 6.0), (40.0, 50.0, 60.0)),
        ControlPoint("C", 2, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    ]


NAMES = [f"scans/project.e57 [{own}]" for own in ("floor-0/office-1", "floor-0/office-2", "3", "hall")]


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("floor-0/office-2", 1),
        ("project.e57 [floor-0/office-2]", 1),
        ("scans/project.e57 [hall]", 3),
        ("hall", 3),
        ("0", 0),
    ],
)
def test_a_scan_of_a_file_of_several_is_meant_by_its_own_name(text, number):
    assert scan_number(text, NAMES, "--fix") == number


@pytest.mark.parametrize(
    ("text", "names", "parts"),
    [
        ("attic", NAMES, ("from 0 to 3, got 'attic'; the names are 'project.e57 [floor-0/office-1]', ",)),
        ("3", NAMES, ("the name of one scan, got '3', which 2 have", "[3]'", "[hall]'")),
        ("hall", ["a.e57 [hall]", "b.e57 [hall]"], ("which 2 have: 'a.e57 [hall]', 'b.e57 [hall]'",)),
        ("a", ["x/s.ply", "y/s.ply"], ("the names are 'x/s.ply', 'y/s.ply'",)),
        ("a", [f"{number}.ply" for number in range(20)], ("'7.ply', ...",)),
    ],
)
def test_a_name_that_means_no_scan_or_several_is_answered_with_names(text, names, parts):
    with pytest.raises(CloudFileError) as caught:
        scan_number(text, names, "--fix")
    for part in ("--fix: expected ", *parts):
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("name,scan,x,y,z\n", ("a header with name, scan, x, y, z, X, Y, Z",)),
        (HEADER + "A,a.ply,1,2,3,4,5\n", ("line 2", "8 cells", "7")),
        (HEADER + "A,a.ply,1,2,three,4,5,6\n", ("line 2", "a number in the column z", "'three'")),
        (HEADER + "A,a.ply,1,2,3,nan,5,6\n", ("a number in the column X",)),
        (HEADER + "A,z.ply,1,2,3,4,5,6\n", ("the name of a scan or a number from 0 to 1", "'z.ply'")),
        (HEADER + "A,2,1,2,3,4,5,6\n", ("a number from 0 to 1", "'2'")),
        (HEADER + "A,same.ply,1,2,3,4,5,6\n", ("the name of one scan", "which 2 have")),
    ],
)
def test_what_is_wrong_with_a_table_is_said(tmp_path, text, parts):
    table = tmp_path / "points.csv"
    table.write_text(text)
    names = ["x/same.ply", "y/same.ply"] if "same" in text else ["a.ply", "b.ply"]
    with pytest.raises(CloudFileError) as caught:
        read_control_points(table, names)
    assert "points.csv" in str(caught.value)
    for part in parts:
        assert part in str(caught.value)


def test_a_table_that_is_not_there_is_named(tmp_path):
    with refuses(str(tmp_path / "none.csv"), "a file"):
        read_control_points(tmp_path / "none.csv", ["a"])


def test_the_frame_turns_by_what_was_asked():
    poses = made_poses(4)
    flat = rigid(rotation_of(torch.tensor([0.0, 0.0, math.pi / 2]).double()), torch.zeros(3).double())
    made = control_frame(points_of(poses, (0, 1, 2, 3), motion=flat), poses, [0.05] * 4)
    assert close(compose(made.T_world_group, inverse(flat)), torch.eye(4).double(), 1e-9)
