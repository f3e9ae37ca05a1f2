"""Properties of the simulated building: rigid and upright truth, joined scans, floors of one plan, refusals."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from determinism import same_bits
from scans import nearest

from torchreg.datasets import SimulatedSite, building
from torchreg.synthetic.architecture.office_floor import room_shell
from torchreg.synthetic.architecture.office_plan import draw_building_plan
from torchreg.synthetic.architecture.rooms import furnished
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.draws import Draws
from torchreg.synthetic.scene.quads import Quads
from torchreg.synthetic.survey import feet, plan_survey

VOXEL = 0.25


@pytest.fixture(scope="module")
def site() -> SimulatedSite:
    return building(3, scans=30, floors=3, shuffled=False)


def in_world(site: SimulatedSite, k: int) -> Array:
    R, t = site.T_world_scan[k, :3, :3], site.T_world_scan[k, :3, 3]
    return (site.scans[k].points.double() @ R.T + t).numpy()


def cells(points: Array) -> Array:
    """The voxels that hold points, as sorted numbers."""
    return np.unique(np.floor(points / VOXEL).astype(np.int64) @ np.array([1, 1 << 20, 1 << 40]))


def overlaps(site: SimulatedSite) -> Array:
    """(N, N) share of the voxels of the scan with fewer that both hold."""
    held = [cells(in_world(site, k)) for k in range(len(site))]
    share = np.zeros((len(site), len(site)))
    for i, one in enumerate(held):
        for j, other in enumerate(held[:i]):
            both = len(np.intersect1d(one, other, assume_unique=True))
            share[i, j] = share[j, i] = both / min(len(one), len(other))
    return share


def joined(share: Array, threshold: float) -> int:
    """How many scans hang together with the first by overlaps above a threshold."""
    reached, fresh = {0}, [0]
    while fresh:
        beside = {int(j) for j in np.flatnonzero(share[fresh.pop()] > threshold)} - reached
        reached |= beside
        fresh += beside
    return len(reached)


def test_types_and_frames(site):
    assert len(site) == 30 == len(site.stations) == len(set(site.stations))
    for scan in site.scans:
        assert 10_000 < scan.lengths[0] < 30_000
        assert scan.points.dtype == torch.float32
        assert torch.equal(scan.viewpoint, torch.zeros(1, 3))
        assert torch.equal(scan.origin, torch.zeros(1, 3, dtype=torch.float64))
        levels = 255 * scan.colors
        assert levels.max() <= 255
        assert (levels - levels.round()).abs().max() < 1e-3
    rotations = site.T_world_scan[:, :3, :3]
    eye = torch.eye(3, dtype=torch.float64).expand_as(rotations)
    assert torch.allclose(rotations @ rotations.mT, eye, atol=1e-12)
    assert torch.allclose(torch.linalg.det(rotations), torch.ones(30, dtype=torch.float64))
    tilt = torch.rad2deg(torch.arccos(rotations[:, 2, 2]))
    assert tilt.max() < 2
    assert tilt.max() > 0.5
    heading = torch.atan2(rotations[:, 1, 0], rotations[:, 0, 0])
    assert heading.max() - heading.min() > math.pi


def test_overlapping_scans_coincide_under_the_truth_and_not_beside_it(site):
    share = overlaps(site)
    i, j = np.unravel_index(np.argmax(share), share.shape)
    one, other = in_world(site, int(i)), in_world(site, int(j))
    apart = nearest(one.astype(np.float32), other.astype(np.float32))[1]
    both = one[apart < 0.05].astype(np.float32)
    assert len(both) > 0.25 * len(one)
    for shift in np.eye(3, dtype=np.float32) * 0.05:
        moved = nearest(both + shift, other.astype(np.float32))[1]
        assert np.mean(moved) > 1.2 * np.mean(apart[apart < 0.05])


@pytest.mark.parametrize(("seed", "scans", "floors"), [(0, 5, 3), (1, 12, 1), (2, 24, 2), (3, 45, 3), (4, 40, 5)])
def test_every_scan_is_joined_to_the_others_by_overlaps(seed, scans, floors):
    share = overlaps(building(seed, scans=scans, floors=floors, angular_step=2.0))
    assert joined(share, 0.15) == scans


def test_without_the_stairs_floors_fall_apart(site):
    share = overlaps(site)
    for k, name in enumerate(site.stations):
        if name.startswith("stairs"):
            share[k] = share[:, k] = 0
    assert joined(share, 0.15) == int((site.floor == site.floor[0]).sum()) - 1


def test_stations_on_stairs_see_parts_of_two_floors(site):
    storey = plan_survey((3, 200), scans=30, floors=3).plan.storey
    for k, name in enumerate(site.stations):
        if name.startswith("stairs"):
            height = in_world(site, k)[:, 2] - storey * site.floor[k].item()
            assert (np.abs(height) < 0.1).mean() > 0.01  # the lower floor
            assert (height > storey + 0.1).mean() > 0.05


def test_floors_have_one_plan_and_differ_a_little_in_what_stands_there():
    plan = draw_building_plan(np.random.default_rng(0), floors=3, wings=1, modules=30)
    rooms = [cell for cell in plan.cells if cell.kind]
    kept = []
    for k, cell in enumerate(rooms):
        alike, other = (furnished(cell.kind, cell.interior, Draws((0, 1, k), floor, 0.0)) for floor in (0, 2))
        assert all((one.corners == two.corners).all() for one, two in zip(alike, other, strict=True))
        one, two = (Quads.join(furnished(cell.kind, cell.interior, Draws((0, 1, k), floor, 1.0))) for floor in (0, 2))
        assert not np.array_equal(one.corners, two.corners)
        apart = nearest(*(quads.corners.reshape(-1, 3).astype(np.float32) for quads in (one, two)))[1]
        kept.append((apart < 0.25).mean())
        shells = [room_shell(plan, cell, Draws((0, 2, k), floor, 1.0)) for floor in (0, 2)]
        walls = [shell[0].corners for shell in shells]
        assert np.array_equal(*walls)
    assert 0.5 < np.mean(kept) < 0.99


def test_same_seed_same_bits_and_other_seed_another_building():
    one, again, other = (building(seed, scans=6, floors=2, angular_step=3.0) for seed in (1, 1, 2))
    assert same_bits(one, again)
    assert not torch.equal(one.T_world_scan, other.T_world_scan)
    assert one.name == "building-1"


def test_order_is_the_walk_or_a_shuffle_of_it():
    walk, mixed = (building(0, scans=20, shuffled=shuffled, angular_step=4.0) for shuffled in (False, True))
    assert walk.floor.tolist() == sorted(walk.floor.tolist())
    assert walk.stations != mixed.stations
    for k, name in enumerate(walk.stations):
        same = mixed.stations.index(name)
        assert torch.equal(walk.T_world_scan[k], mixed.T_world_scan[same])
        assert torch.equal(walk.scans[k].points, mixed.scans[same].points)
        assert walk.floor[k] == mixed.floor[same]
    step = (walk.T_world_scan[1:, :3, 3] - walk.T_world_scan[:-1, :3, 3]).norm(dim=1)
    assert step.median() < 6


def test_global_random_state_is_left_alone():
    np.random.seed(5)
    expected = np.random.random(3)
    np.random.seed(5)
    building(0, scans=5, angular_step=5.0)
    assert (np.random.random(3) == expected).all()


@pytest.mark.parametrize(("scans", "floors"), [(5, 1), (39, 20), (60, 3), (120, 2), (300, 3), (500, 3), (500, 20)])
def test_a_building_has_as_many_stations_as_asked_for(scans, floors):
    plan, stations = plan_survey((0, 7), scans=scans, floors=floors)
    assert len(stations) == scans == len({station.name for station in stations})
    assert {station.floor for station in stations} == set(range(floors))
    place = feet(stations)
    apart = np.linalg.norm(place[:, None] - place, axis=2) + 9 * np.eye(scans)
    assert apart.min() > 1
    assert bool(plan.stairwells) == (floors > 1)


@pytest.mark.parametrize("seed", range(5))
def test_rows_of_rooms_fill_their_wings(seed):
    plan = draw_building_plan(np.random.default_rng(seed), floors=2, wings=2, modules=20)
    rows: dict[tuple[float, int], list[tuple[float, float]]] = {}
    for cell in plan.cells:
        half = cell.interior.width / 2
        rows.setdefault((cell.y, cell.facing), []).append((cell.x - half, cell.x + half))
    assert len(rows) == 4
    for spans in rows.values():
        edges = sorted(spans)
        assert edges[0][0] == pytest.approx(0)
        assert edges[-1][1] == pytest.approx(plan.length)
        assert all(left[1] == pytest.approx(right[0]) for left, right in pairwise(edges))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scans": 4}, "scans: expected an integer of at least 5, got 4"),
        ({"scans": 8, "floors": 5}, "scans: expected an integer of at least 9, got 8"),
        ({"scans": 501}, "scans: expected at most 500, got 501"),
        ({"scans": 10.0}, "scans: expected an integer"),
        ({"floors": 0}, "floors: expected an integer of at least 1, got 0"),
        ({"floors": 21, "scans": 100}, "floors: expected at most 20, got 21"),
        ({"variety": 1.5}, r"variety: expected a number in \[0, 1\], got 1.5"),
        ({"angular_step": 0.0}, r"angular_step: expected degrees in \[0.1, 5\], got 0.0"),
        ({"range_noise": float("nan")}, "range_noise: expected meters"),
        ({"relight": "sunny"}, "relight: expected a number, got 'sunny'"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises(ValueError, match=message):
        building(**options)


def test_a_site_refuses_what_does_not_fit(site):
    with pytest.raises(ValueError, match=r"T_world_scan: expected \(30, 4, 4\)"):
        SimulatedSite(site.scans, site.T_world_scan[1:], site.floor, site.stations, "x")
    with pytest.raises(ValueError, match="stations: expected 30 names"):
        SimulatedSite(site.scans, site.T_world_scan, site.floor, site.stations[1:], "x")
