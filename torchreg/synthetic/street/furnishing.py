"""What stands where along a road, and in which of the two scans."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from torchreg.synthetic import furniture
from torchreg.synthetic.placing import FIXED, ONLY_SOURCE, ONLY_TARGET, Contents, Kind, clear_of, scatter
from torchreg.synthetic.scene.arrays import Array
from torchreg.synthetic.scene.quads import Quads
from torchreg.synthetic.street import fittings, plants
from torchreg.synthetic.street.plan import LEVEL, SIDES, StreetPlan
from torchreg.synthetic.street.vehicles import car, van

_ON_LAWNS = (
    Kind(plants.broadleaf, 2.4, 6, FIXED),
    Kind(plants.conifer, 1.6, 5, FIXED),
    Kind(fittings.bicycle_rack, 2.2, 2, FIXED),
    Kind(fittings.containers, 2.2, 2, FIXED),
    Kind(furniture.bench, 1.0, 4, FIXED),
)
_ON_PAVEMENTS = (
    Kind(fittings.traffic_sign, 0.2, 6, FIXED),
    Kind(furniture.litter_bin, 0.3, 3, FIXED),
    Kind(furniture.person, 0.4, 5, ONLY_SOURCE),
    Kind(furniture.person, 0.4, 5, ONLY_TARGET),
)


def furnish(plan: StreetPlan, stations: Sequence[Array], rng: np.random.Generator) -> Contents:
    """All that stands on lawns and pavements, as the source scan and the target scan see it.

    Args:
        plan: the road.
        stations: poses (4, 4) of the scanners; what would stand right beside one is left out of both scans.
        rng: the same draws wherever the stations are.
    """
    rows, taken = [], []
    for side in SIDES:
        for piece, spot, radius in _in_rows(plan, side, rng):
            rows.append(piece.placed(*spot, LEVEL, yaw=math.pi if side < 0 else 0.0))
            taken.append((*spot, radius))
    occupied = np.array(taken)

    def on_lawns(radius: float, rng: np.random.Generator) -> Array:
        return _strips(plan, [(plan.lawn_from(s) + radius, plan.front(s) - radius - 0.3) for s in SIDES], rng)

    def on_pavements(radius: float, rng: np.random.Generator) -> Array:
        return _strips(plan, [(plan.kerb(s) + radius + 0.1, plan.lawn_from(s) - radius) for s in SIDES], rng)

    loose = [scatter(_ON_LAWNS, on_lawns, occupied, stations, rng)]
    loose.append(scatter(_ON_PAVEMENTS, on_pavements, occupied, stations, rng))
    seen = [[piece.placed(0, 0, LEVEL) for contents in loose for piece in contents[k]] for k in (0, 1)]
    return rows + seen[0], rows + seen[1]


def parked(plan: StreetPlan, stations: Sequence[Array], rng: np.random.Generator) -> Contents:
    """The cars in the parking lanes; some leave and some come between the scans. Arguments as for ``furnish``."""
    contents: Contents = ([], [])
    for side in SIDES:
        for x in plan.slots:
            make: Callable[[np.random.Generator], Quads] = car if rng.random() < 0.8 else van
            vehicle, stays = make(rng), rng.random()
            spot = np.array([x, side * plan.lane]) + rng.uniform((-0.3, -0.15), (0.3, 0.15))
            yaw = rng.uniform(-0.04, 0.04) + math.pi * (rng.random() < (0.15 if side < 0 else 0.85))
            if plan.parking[side > 0] and clear_of(stations, spot, 2.4):
                for k, share in ((0, (0.0, 0.66)), (1, (0.1, 0.76))):
                    if share[0] <= stays < share[1]:
                        contents[k].append(vehicle.placed(spot[0], spot[1], yaw=yaw))
    return contents


def _in_rows(plan: StreetPlan, side: int, rng: np.random.Generator) -> list[tuple[Quads, tuple[float, float], float]]:
    """Trees and lamp posts along one side, a hedge, flags or a shelter: piece, place (x, y) and radius."""
    pieces = []
    for spot in _row(plan, side, rng.uniform(8, 13), plan.lawn_from(side) + 1.5, 1.2, rng):
        tree = plants.broadleaf(rng)
        if rng.random() < 0.85:
            pieces.append((tree, spot, 1.0))
    tall = rng.uniform(5, 7)
    for spot in _row(plan, side, 24.0, plan.kerb(side) + 0.35, 0.2, rng):
        pieces.append((fittings.lamp_post(rng, tall), spot, 0.3))
    for spot in _row(plan, side, rng.uniform(16, 22), plan.front(side) - 0.9, 0.0, rng):
        pieces.append((plants.hedge(rng, rng.uniform(4, 9)), spot, 1.0))
    if rng.random() < 0.6:
        start, lawn = rng.uniform(-16, 10), plan.lawn_from(side)
        for k in range(int(rng.integers(2, 5))):
            pieces.append((fittings.flag(rng), (start + 2.2 * k, side * (lawn + 0.4)), 0.6))
    if rng.random() < 0.5:
        place = (rng.uniform(-20, 20), side * (plan.lawn_from(side) + 0.3))
        pieces.append((fittings.shelter(rng), place, 2.2))
    start = plan.crossing + rng.uniform(3.5, 5)
    pieces.append((fittings.bollards(rng), (start + 2.6, side * (plan.kerb(side) + 0.4)), 2.8))
    return pieces


def _row(
    plan: StreetPlan, side: int, pitch: float, y: float, jitter: float, rng: np.random.Generator
) -> list[tuple[float, float]]:
    """Places along one side, ``pitch`` meters apart and ``y`` from the middle of the road, each a little off."""
    x = np.arange(-0.47 * plan.length + rng.uniform(0, pitch), 0.47 * plan.length, pitch)
    off = jitter * rng.uniform(-1, 1, (len(x), 2))
    return [(a + b, side * (y + 0.4 * c)) for a, (b, c) in zip(x, off, strict=True)]


def _strips(plan: StreetPlan, edges: list[tuple[float, float]], rng: np.random.Generator) -> Array:
    """A hundred random places (100, 2) in two strips along the road, near to far for each of ``SIDES``."""
    which = rng.integers(2, size=100)
    near, far = np.array(edges)[which].T
    x = 0.4 * plan.length * rng.uniform(-1, 1, 100)
    return np.stack((x, np.array(SIDES)[which] * (near + (far - near) * rng.random(100))), axis=1)
