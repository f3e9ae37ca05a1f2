"""Scans of a simulated office building of several floors, with the true poses of the scanner.

What is alike on all floors: the plan (walls, doors, windows, stairs, lamps), the kinds of rooms, where their furniture
belongs, and about half of its models and colors. What differs from floor to floor, as in a real building: furniture
stands a decimeter or so elsewhere, some pieces are missing, turned or of another make, half of the carpets and painted
walls have another color, most posters and the goods on shelves are a floor's own, and each floor has its color of
signs, of a wall on its landing, and of the corridors' ends. One room in four changes little. Rooms of one kind on one
floor are alike in size and arrangement too. So many scans look alike, and some nearly the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch

from torchreg.entry import entry
from torchreg.errors import at_least, expect
from torchreg.seeds import numpy_seed
from torchreg.synthetic.architecture.office_floor import corridors, lamps_of, room_shell
from torchreg.synthetic.architecture.office_plan import BuildingPlan, PlanCell
from torchreg.synthetic.architecture.rooms import furnished
from torchreg.synthetic.architecture.stairs import stair_lamps, stairwell
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.draws import Draws
from torchreg.synthetic.scene.environment import expect_within
from torchreg.synthetic.scene.light import Light, exposed_camera, indoor_light
from torchreg.synthetic.scene.quads import Quads, up
from torchreg.synthetic.scene.scanner import LaserScanner, Raycaster, pose, scan
from torchreg.synthetic.survey import Station, feet, plan_survey
from torchreg.types.simulated_site import SimulatedSite

_STREAM = 200  # number of the first random stream; malls and roads have those below
_MOST_SCANS, _MOST_FLOORS = 500, 20
_TRIPOD = (1.5, 1.75)  # meters above the floor
_LAMPS_NEAR = 4  # that light a point
_CELL = 0.5  # meters, of the raster of lamps


@entry
def building(
    seed: int = 0,
    *,
    scans: int = 60,
    floors: int = 3,
    variety: float = 1.0,
    shuffled: bool = True,
    angular_step: float = 1.4,
    range_noise: float = 0.004,
    relight: float = 0.5,
) -> SimulatedSite:
    """Scan one simulated office building from many stations.

    The building is as large as so many stations need: one every 4 to 5 m of corridor, one or two in most rooms, behind
    their open doors, one on each landing of the stairs, and one halfway between floors. The same arguments give the
    same bits. ``shuffled`` and the last three options leave building and stations alone.

    Args:
        seed: which building; any integer.
        scans: how many, in [5, 500], and at least ``2 * floors - 1``.
        floors: how many of one plan lie above each other, in [1, 20].
        variety: how much furniture, posters and paint differ from floor to floor, in [0, 1]; 0 makes all floors
            identical, which no one could tell apart but by the stairs.
        shuffled: scans come in random order; else in that of a walk through the building, floor by floor.
        angular_step: degrees between neighboring rays, in [0.1, 5]; the default gives some 20,000 points a scan.
        range_noise: meters, standard deviation of a range at 10 m on a surface that faces the scanner, in [0, 0.1].
        relight: how much light and camera differ between the scans, in [0, 2].

    Returns:
        The scans, each in the frame of its own scanner (turned at random, tilted by up to 2 degrees), float32 in
        meters with colors in [0, 1] (steps of 1/255) and the scanner at zero, and their true poses.

    Raises:
        ValueError: an argument out of its range.
        ImportError: Open3D is not installed.

    Example:
        >>> site = building(seed=1, scans=5, angular_step=4.0)
        >>> len(site), site.T_world_scan.shape, sorted(site.stations)[0]
        (5, torch.Size([5, 4, 4]), 'floor-0/landing-0')
    """
    at_least(floors, "floors", 1)
    expect(floors <= _MOST_FLOORS, "floors", f"at most {_MOST_FLOORS}", floors)
    fewest = max(5, 2 * floors - 1)
    at_least(scans, "scans", fewest)
    expect(scans <= _MOST_SCANS, "scans", f"at most {_MOST_SCANS}", scans)
    expect_within(variety, "variety", "a number", 0, 1)
    expect_within(angular_step, "angular_step", "degrees", 0.1, 5)
    expect_within(range_noise, "range_noise", "meters", 0, 0.1)
    expect_within(relight, "relight", "a number", 0, 2)
    entropy = numpy_seed(seed)
    of_plan, of_rooms, of_poses, of_light, of_cameras, of_order, of_noise = ((entropy, _STREAM + k) for k in range(7))
    rng = np.random.default_rng

    plan, stations = plan_survey(of_plan, scans=scans, floors=floors)
    caster = Raycaster(Quads.join(list(_parts(plan, of_rooms, variety))))
    poses = _poses(stations, rng(of_poses))
    lamps = LampRaster(plan)
    scanner = LaserScanner(angular_step=angular_step, range_noise=range_noise)
    errors, probes = rng(of_cameras), lamps.positions - up(plan.height - 1)
    clouds = []
    for k, T_world_scanner in enumerate(poses):
        weather = relight * math.sin(0.15 * k)  # which changes slowly while the surveyor works
        light = _light(lamps, weather, rng(of_light))
        camera = exposed_camera(light, probes, 0.5 * relight, errors, sunlit=0.02)
        clouds.append(scan(caster, light, camera, T_world_scanner, scanner, seed=(*of_noise, k)))
    order = rng(of_order).permutation(scans) if shuffled else np.arange(scans)
    return SimulatedSite(
        scans=tuple(clouds[k] for k in order),
        T_world_scan=torch.from_numpy(poses[order]),
        floor=torch.tensor([stations[k].floor for k in order]),
        stations=tuple(stations[k].name for k in order),
        name=f"building-{seed}",
    )


def _parts(plan: BuildingPlan, stream: tuple[int, ...], variety: float) -> Iterator[Quads]:
    """All quads of the building, floor by floor."""
    for floor in range(plan.floors):
        z = floor * plan.storey

        def draws(part: int, floor: int = floor) -> Draws:
            return Draws((*stream, part), floor, variety)

        yield from (piece.placed(0, 0, z) for piece in corridors(plan, floor, draws(0)))
        for k, cell in enumerate(plan.cells):
            if cell.kind is None:
                pieces = stairwell(plan, cell, floor, draws(2 * k + 1))
            else:
                pieces = room_shell(plan, cell, draws(2 * k + 1))
                pieces += furnished(cell.kind, cell.interior, draws(2 * k + 2))
            yield Quads.join(pieces).placed(cell.x, cell.y, z, yaw=0.0 if cell.facing > 0 else math.pi)


def _poses(stations: tuple[Station, ...], rng: np.random.Generator) -> Array:
    """``T_world_scanner`` (N, 4, 4) of the scanner on its tripod at each station."""
    low, high = (-math.pi, 0, -math.pi, _TRIPOD[0]), (math.pi, math.radians(2), math.pi, _TRIPOD[1])
    poses = []
    for place in feet(stations):
        yaw, tilt, tilt_heading, height = rng.uniform(low, high)
        poses.append(pose(place + up(height), yaw, tilt, tilt_heading))
    return np.stack(poses)


def _light(lamps: LampRaster, weather: float, rng: np.random.Generator) -> Light:
    """Lamps everywhere, and the sun through the windows."""
    light = indoor_light(lamps.positions, np.full(len(lamps.positions), 4.5), np.zeros(3), 0.0, weather, rng)
    return replace(light, near_lamps=lamps.near)


class LampRaster:
    """The lamps of a building, and which of them light a point: the nearest in plan on the point's own floor."""

    def __init__(self, plan: BuildingPlan) -> None:
        on_floor = np.array([lamp for cell in plan.cells for lamp in _lamps_of(plan, cell)] + _corridor_lamps(plan))
        z = plan.storey * np.arange(plan.floors)[:, None, None] * np.array([0, 0, 1.0])
        self.positions = (on_floor + z).reshape(-1, 3)  # (floors * L, 3)
        self._floors, self._storey, self._count = plan.floors, plan.storey, len(on_floor)
        self._low = on_floor[:, :2].min(axis=0) - 3.0
        self._shape = np.ceil((on_floor[:, :2].max(axis=0) + 3.0 - self._low) / _CELL).astype(np.int64)
        x, y = (self._low[k] + _CELL * (np.arange(self._shape[k]) + 0.5) for k in (0, 1))
        raster = np.empty((*self._shape, min(_LAMPS_NEAR, self._count)), dtype=np.int64)
        for i, place in enumerate(x):
            apart = np.hypot(place - on_floor[:, 0], y[:, None] - on_floor[:, 1])  # (Y, L)
            raster[i] = np.argsort(apart, axis=1, kind="stable")[:, : raster.shape[2]]
        self._raster = raster

    def near(self, points: Array) -> Array:
        """Indices (P, K) among ``positions`` of the lamps near the points (P, 3)."""
        i, j = np.clip(((points[:, :2] - self._low) / _CELL).astype(np.int64), 0, self._shape - 1).T
        floor = np.clip((points[:, 2] / self._storey).astype(np.int64), 0, self._floors - 1)
        return np.asarray(self._raster[i, j] + self._count * floor[:, None])


def _lamps_of(plan: BuildingPlan, cell: PlanCell) -> list[tuple[float, float, float]]:
    lamps = stair_lamps(plan, cell) if cell.kind is None else lamps_of(cell.interior)
    return [(*cell.in_plan(x, y), z) for x, y, z in lamps]


def _corridor_lamps(plan: BuildingPlan) -> list[tuple[float, float, float]]:
    """One every 3 m or so of corridors and passages."""
    z, aside = plan.height - 0.12, plan.passage
    x = np.linspace(1.2 - aside, plan.length + aside - 1.2, max(2, round((plan.length + 2 * aside) / 3)))
    lamps = [(float(place), plan.corridor_y(wing), z) for wing in range(plan.wings) for place in x]
    for wing in range(plan.wings - 1):
        y = plan.corridor_y(wing) + plan.corridor / 2 + 2 * plan.depth * (np.arange(4) + 0.5) / 4
        lamps += [(end, float(place), z) for end in (-aside / 2, plan.length + aside / 2) for place in y]
    return lamps
