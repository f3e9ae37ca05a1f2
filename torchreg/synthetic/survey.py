"""Where a surveyor sets up the scanner in an office building, and in which order.

On every floor there are stations along the corridors, on the landings of the stairs, and in the rooms behind their
doors, from where the corridor shows; between floors there is one on each middle landing. Where fewer are wanted, rooms
are left out and then the ends of corridors, so that those left are joined.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from torchreg.synthetic.architecture.office_plan import BuildingPlan, PlanCell, draw_building_plan
from torchreg.synthetic.architecture.stairs import landing_station, middle_station
from torchreg.synthetic.scene import Array

_STATION_EVERY = 4.6  # meters at most between stations of a corridor
_ASIDE = 1.1  # meters that a station is moved along the corridor to stand before a door
_FEWEST_MODULES = 7
_STATIONS_PER_WING = 55  # of a floor; more make another wing


class Station(NamedTuple):
    """A place of the tripod's feet."""

    name: str
    x: float  # meters
    y: float  # meters
    z: float  # meters
    floor: int  # of a middle landing the one below
    walk: tuple[float, float]  # sorts stations of a floor into the order of a walk
    room: bool = False  # whether it is in a room, without which the others stay joined
    away: float = 0.0  # meters to walk from the first stairs; 0 for rooms


class BuildingSurvey(NamedTuple):
    """A building and the stations in it."""

    plan: BuildingPlan
    stations: tuple[Station, ...]  # in order of acquisition


def plan_survey(stream: tuple[int, ...], *, scans: int, floors: int) -> BuildingSurvey:
    """The smallest building of a random stream that has so many stations, and so many of them."""
    per_floor = scans / floors
    wings = max(1, math.ceil(per_floor / _STATIONS_PER_WING))
    modules = max(_FEWEST_MODULES, int(0.6 * per_floor / wings))
    while True:
        rng = np.random.default_rng((*stream, modules))
        plan = draw_building_plan(rng, floors=floors, wings=wings, modules=modules)
        stations = [*_on_floors(plan, rng), *_between_floors(plan)]
        if len(stations) >= scans:
            return BuildingSurvey(plan, _chosen(stations, scans, rng))
        modules += 1


def _chosen(stations: list[Station], scans: int, rng: np.random.Generator) -> tuple[Station, ...]:
    """So many stations: rooms are left out at random, then what is farthest from the stairs."""
    rank = rng.permutation(len(stations))
    keep = sorted(range(len(stations)), key=lambda i: (stations[i].room, stations[i].away, rank[i]))[:scans]
    return tuple(sorted((stations[i] for i in keep), key=lambda station: (station.floor, station.walk)))


def _on_floors(plan: BuildingPlan, rng: np.random.Generator) -> Iterator[Station]:
    stairs = [(cell, *cell.in_plan(*landing_station()[:2])) for cell in plan.stairwells]
    x0, y0 = stairs[0][1:] if stairs else (plan.length / 2, 0.0)

    def walked(x: float, y: float) -> float:
        return abs(x - x0) + abs(y - y0)

    for floor in range(plan.floors):
        z = floor * plan.storey
        label = f"floor-{floor}"
        for k, (cell, x, y) in enumerate(stairs):
            corridor = cell.y - cell.facing * plan.corridor / 2
            yield Station(f"{label}/landing-{k}", x, y, z, floor, (corridor, x), away=0.0 if k == 0 else walked(x, y))
        for k, (x, y) in enumerate(_corridor_places(plan)):
            shift_x, shift_y = rng.uniform(-0.25, 0.25, 2)
            place = x + shift_x, y + shift_y
            yield Station(f"{label}/corridor-{k}", *place, z, floor, (y, x), away=walked(*place))
        for k, cell in enumerate(plan.cells):
            for local in cell.stations:
                shift_x, shift_y = rng.uniform(-0.08, 0.08, 2)
                x, y = cell.in_plan(*local)
                kind = cell.kind.name if cell.kind else ""
                suffix = "" if local == cell.stations[0] else "b"
                corridor = cell.y - cell.facing * plan.corridor / 2
                name = f"{label}/{kind}-{k}{suffix}"
                yield Station(name, x + shift_x, y + shift_y, z, floor, (corridor, x), room=True)


def _corridor_places(plan: BuildingPlan) -> list[tuple[float, float]]:
    """Places along corridors and passages: one before every stairwell, the others evenly between."""
    places = []
    for wing in range(plan.wings):
        y = plan.corridor_y(wing)
        start, end = (-plan.passage / 2, plan.length + plan.passage / 2) if plan.passage else (-0.6, plan.length + 0.6)
        fixed = _apart(sorted(cell.x for cell in plan.stairwells if abs(cell.y - y) < plan.corridor))
        stops = [start, *fixed, end]
        inner = [
            low + (high - low) * (k + 1) / count
            for low, high in pairwise(stops)
            for count in [max(1, math.ceil((high - low) / _STATION_EVERY))]
            for k in range(count - 1)
        ]
        doors = [cell.in_plan(cell.interior.door, 0.0)[0] for cell in plan.cells if _behind_a_wall(plan, cell, y)]
        inner = [_moved(x, doors) for x in inner]
        crossings = [start, end] if plan.passage else []
        places += [(x, y) for x in sorted([*inner, *fixed, *crossings])]
    count = math.ceil(2 * plan.depth / _STATION_EVERY)
    for wing in range(plan.wings - 1):
        low = plan.corridor_y(wing) + plan.corridor / 2
        along = [low + 2 * plan.depth * (k + 0.5) / count for k in range(count)]
        places += [(x, y) for x in (-plan.passage / 2, plan.length + plan.passage / 2) for y in along]
    return places


def _moved(x: float, doors: list[float]) -> float:
    """The nearest of the doors, if it is near enough to move a station there, from where one sees far into the room."""
    nearest = min(doors, key=lambda door: abs(door - x), default=x)
    return nearest if abs(nearest - x) < _ASIDE else x


def _behind_a_wall(plan: BuildingPlan, cell: PlanCell, y: float) -> bool:
    """Whether a cell is a room at the corridor at ``y`` that shows through its door alone."""
    return cell.kind is not None and cell.kind.front == "closed" and abs(cell.y - y) < plan.corridor


def _apart(places: list[float]) -> list[float]:
    """Ascending places without those that another is close to: one station does for two stairwells face to face."""
    kept: list[float] = []
    for place in places:
        if not kept or place - kept[-1] > _STATION_EVERY / 2:
            kept.append(place)
    return kept


def _between_floors(plan: BuildingPlan) -> Iterator[Station]:
    for floor in range(plan.floors - 1):
        for k, cell in enumerate(plan.stairwells):
            x, y, up = middle_station(plan, cell)
            place = cell.in_plan(x, y)
            name, walk = f"stairs-{k}/{floor}-{floor + 1}", (math.inf, place[0])  # after all others of the floor
            yield Station(name, *place, floor * plan.storey + up, floor, walk, away=0.0 if k == 0 else math.inf)


def feet(stations: tuple[Station, ...]) -> Array:
    """Where the tripods stand, (N, 3) meters."""
    return np.array([(station.x, station.y, station.z) for station in stations])
