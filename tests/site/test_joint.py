"""Scans refined together: to the millimeter where surfaces hold them, and no farther than links allow."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from determinism import same_bits, threads
from problems import seeded
from refusals import refuses
from rooms import Rooms, best_fit, rooms, rough_links

from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.refinement.surfels import Surfels, surfels_of
from torchreg.site import KnownPose, Tolerance, loose_covariance, place
from torchreg.site.control import ControlPoint, misses
from torchreg.site.frame import SiteFrame, frame_of
from torchreg.site.joint import refine_together
from torchreg.site.scan_surfels import surfel_count

REACH = 0.1
ALLOWED = Tolerance(meters=0.1, degrees=2.0)


class Case:
    def __init__(self, made: Rooms, pairs, *, meters=0.015, known=()):
        self.made, self.known = made, known
        self.surfels = [surfels_of(scan, 20_000) for scan in made.scans]
        self.links = rough_links(made, pairs, meters)
        self.placement = place(self.links, len(made.scans), tolerance=ALLOWED, known=known)

    def refined(self, surfels=None, tolerance=ALLOWED):
        every = self.surfels if surfels is None else surfels
        return refine_together(
            self.placement, self.links, every.__getitem__, tolerance=tolerance, reach=REACH, known=self.known
        )


def chain(count):
    return [(scan, scan + 1) for scan in range(count - 1)]


@pytest.fixture(scope="module")
def case():
    return Case(rooms(6), chain(11))


@pytest.fixture(scope="module")
def together(case):
    return case.refined()


def test_a_chain_of_eleven_scans_is_right_to_millimeters(case, together):
    before, after = (best_fit(each.T_world_scan, case.made.poses) for each in (case.placement, together.placement))
    assert before.max() > 0.015
    assert after.max() < 0.004
    assert together.notes == ((),) * 11
    assert together.pairs > 10  # scans of neighboring rooms, which no link joins


def test_errors_are_about_what_covariances_say(case, together):
    truth = compose(inverse(case.made.poses[:1]), case.made.poses)
    placement = together.placement
    off = compose(placement.T_world_scan, inverse(truth))
    center = placement.center
    shift = (off[:, :3, :3] @ center[:, :, None])[:, :, 0] + off[:, :3, 3] - center
    deviation = placement.covariance.diagonal(dim1=1, dim2=2)[:, 3:].sqrt()
    apart = (shift / deviation)[1:].abs()
    assert apart.max() < 4
    assert deviation.max() < 0.02


def test_links_are_held_against_the_new_poses(case, together):
    placement = together.placement
    for row, link in enumerate(case.links):
        T = compose(inverse(placement.T_world_scan[link.target]), placement.T_world_scan[link.source])
        D = compose(T, inverse(link.T_target_source))
        shift = D[:3, :3] @ link.center + D[:3, 3] - link.center
        # about the center as the link's first scan has it: the turn is small, so is the difference
        assert abs(float(shift.norm() - placement.meters[row])) < 1e-3


def test_threads_and_how_often_scans_are_loaded_change_no_bit(case, together, monkeypatch):
    monkeypatch.setattr("torchreg.site.scan_surfels._KEPT", 2)
    monkeypatch.setattr("torchreg.site.joint._AT_ONCE", 1)
    with threads(3):
        again = case.refined()
    assert same_bits(again.placement.T_world_scan, together.placement.T_world_scan)
    assert same_bits(again.placement.covariance, together.placement.covariance)


def test_another_order_of_scans_gives_the_same_poses(case, together):
    order = [3, 9, 0, 5, 1, 10, 2, 4, 8, 6, 7]
    at = {scan: number for number, scan in enumerate(order)}
    links = [replace(link, target=at[link.target], source=at[link.source]) for link in case.links]
    placement = place(links, 11, tolerance=ALLOWED)
    surfels = [case.surfels[scan] for scan in order]
    again = refine_together(placement, links, surfels.__getitem__, tolerance=ALLOWED, reach=REACH)
    moved = together.placement.T_world_scan[order]
    expected = compose(inverse(moved[:1]), moved)
    torch.testing.assert_close(again.placement.T_world_scan, expected, rtol=0, atol=5e-5)  # where rounds end


def test_a_scan_with_wrong_surfaces_is_held_by_its_links(case, together):
    away = rigid(torch.eye(3), torch.tensor([0.0, 0.06, 0.0])).double()
    wrong = list(case.surfels)
    cloud = wrong[4].cloud
    wrong[4] = replace(wrong[4], cloud=replace(cloud, points=(cloud.points.double() + away[:3, 3]).float()))
    tight = Case(case.made, chain(11), meters=0.003)
    result = tight.refined(wrong, Tolerance(meters=0.01, degrees=1.0))
    assert "held by" in result.notes[4][0]
    assert sum(map(len, result.notes)) <= 2
    assert best_fit(result.placement.T_world_scan, case.made.poses).max() < 0.03


def test_along_a_bare_corridor_the_link_stands():
    parts = [rooms(1, 8000, furnished=False, seed=seed) for seed in (1, 2)]
    poses = torch.cat([part.poses for part in parts])
    scans = [_without_ends(part.scans[0], part.poses[0]) for part in parts]
    corridor = Case(Rooms(scans, poses), [(0, 1)], meters=0.03)
    before, after = (
        _error_in_world(each.T_world_scan, poses) for each in (corridor.placement, corridor.refined().placement)
    )
    assert before[:, 3].abs().min() > 0.01  # every axis has something to refine
    assert (after[1:3, 3].abs() < 0.004).all()
    assert abs(float(after[0, 3] - before[0, 3])) < 0.005
    deviation = corridor.refined().placement.covariance[1].diagonal()[3:].sqrt()
    assert deviation.max() > 0.025


def test_known_poses_keep_the_frame_of_the_world():
    made = rooms(2)
    north = rigid(torch.eye(3).double(), torch.tensor([4e5, 5.8e6, 100.0]).double())
    known = [KnownPose(scan=1, T_world_scan=compose(north, made.poses[1]), covariance=loose_covariance(0.001, 5.0))]
    case = Case(made, chain(3), known=known)
    placement = case.refined().placement
    assert placement.in_world.all()
    off = compose(inverse(compose(north, made.poses)), placement.T_world_scan)
    assert off[:, :3, 3].norm(dim=1).max() < 0.006
    with refuses("known", "the known poses of the placement"):
        refine_together(case.placement, case.links, case.surfels.__getitem__, tolerance=ALLOWED, reach=REACH)


def test_control_points_at_both_ends_bend_a_chain_into_the_world(case):
    north = rigid(torch.eye(3).double(), torch.tensor([4e5, 5.8e6, 100.0]).double())
    truth = compose(north, case.made.poses)
    generator = seeded(3)
    points = []
    for scan in (0, 0, 5, 10, 10):
        here = 3 * torch.rand(3, generator=generator, dtype=torch.float64) - 1
        there = truth[scan, :3, :3] @ here + truth[scan, :3, 3]
        points.append(ControlPoint(f"P{len(points)}", scan, tuple(here.tolist()), tuple(there.tolist())))
    made = frame_of(case.placement, SiteFrame(control=tuple(points)), case.made.scans)
    result = refine_together(
        made.placement, case.links, case.surfels.__getitem__, tolerance=ALLOWED, reach=REACH, known=made.known
    )
    before, after = ((each.T_world_scan - truth)[:, :3, 3].norm(dim=1) for each in (made.placement, result.placement))
    assert after.max() < 0.006
    assert after.max() < before.max() / 2
    assert max(misses(points, result.placement.T_world_scan)) < max(misses(points, made.placement.T_world_scan))
    assert result.placement.covariance[5].diagonal()[3:].sqrt().max() < 0.01


def test_scans_without_surfels_and_scans_that_are_not_placed_stay(case):
    bare = surfels_of(case.made.scans[3].rows(torch.zeros(0, dtype=torch.int64), torch.tensor([0, 0])), 100)
    links = case.links[:5]  # scans from 6 on are not placed
    placement = place(links, 11, tolerance=ALLOWED)
    asked = set()

    def surfels(scan: int) -> Surfels:
        asked.add(scan)
        return bare if scan == 3 else case.surfels[scan]

    result = refine_together(placement, links, surfels, tolerance=ALLOWED, reach=REACH)
    assert asked == set(range(6))
    assert result.placement.T_world_scan[6:].isnan().all()
    assert result.placement.group.tolist() == placement.group.tolist()
    assert result.placement.T_world_scan[:6].isfinite().all()


@pytest.mark.parametrize(("points", "count"), [(0, 500), (10_000, 2000), (27_000, 5400), (10**7, 20_000)])
def test_surfels_are_a_fifth_of_the_points_within_bounds(points, count):
    assert surfel_count(points) == count


def test_other_links_than_those_of_the_placement_are_refused(case):
    with refuses("links", "those of the placement (10)", "got 9"):
        refine_together(case.placement, case.links[1:], case.surfels.__getitem__, tolerance=ALLOWED, reach=REACH)


def _without_ends(scan, pose):
    x = (scan.points.double() @ pose[:3, :3].t() + pose[:3, 3])[:, 0]
    rows = ((x > 0.05) & (x < 3.95)).nonzero()[:, 0]
    return scan.rows(rows, torch.tensor([0, len(rows)]))


def _error_in_world(T_world_scan, poses):
    """The motion (4, 4) in the frame of the true poses that takes scan 1 from where it should be to where it is."""
    return compose(compose(poses[0], T_world_scan[1]), inverse(poses[1]))
