"""Two scans of a simulated campus road, with the true motion between them.

A road is drawn from the seed, with houses, trees, kerbs and parked cars along it, and scanned from two stations by
ray casting under the open sky. Between the scans some cars leave and others come, other people walk there, and the
weather changes. Windows, trees and lamp posts repeat in shape.
"""

from __future__ import annotations

import math

import numpy as np

from torchreg.entry import entry
from torchreg.synthetic.architecture.street import LEVEL, SIDES, StreetPlan, draw_plan, ground, houses
from torchreg.synthetic.furniture import indoor, outdoor, plants
from torchreg.synthetic.furniture.vehicles import car, van
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.environment import Environment, scan_twice
from torchreg.synthetic.scene.light import daylight
from torchreg.synthetic.scene.placing import FIXED, ONLY_SOURCE, ONLY_TARGET, Contents, Pieces, clear_of, scatter
from torchreg.synthetic.scene.quads import Quads
from torchreg.synthetic.scene.scanner import LaserScanner
from torchreg.types.scan_pair import ScanPair

_ON_LAWNS = (
    Pieces(plants.broadleaf, 2.4, 6, FIXED),
    Pieces(plants.conifer, 1.6, 5, FIXED),
    Pieces(outdoor.bicycle_rack, 2.2, 2, FIXED),
    Pieces(outdoor.containers, 2.2, 2, FIXED),
    Pieces(indoor.bench, 1.0, 4, FIXED),
)
_ON_PAVEMENTS = (
    Pieces(outdoor.traffic_sign, 0.2, 6, FIXED),
    Pieces(indoor.litter_bin, 0.3, 3, FIXED),
    Pieces(indoor.person, 0.4, 5, ONLY_SOURCE),
    Pieces(indoor.person, 0.4, 5, ONLY_TARGET),
)


@entry
def road(
    seed: int = 0,
    *,
    baseline: float = 6.0,
    angular_step: float = 0.4,
    range_noise: float = 0.004,
    relight: float = 1.0,
) -> ScanPair:
    """Scan one simulated campus road from two stations.

    The same arguments give the same bits. ``baseline`` moves the stations and removes what would stand right beside
    them; all other options leave road and stations alone.

    Args:
        seed: which road; any integer.
        baseline: meters between the two stations, in [0, 30]; 0 scans twice from one place, the scanner turned.
        angular_step: degrees, as for ``mall``; the default gives some 180,000 points a scan.
        range_noise: meters, as for ``mall``.
        relight: as for ``mall``.

    Returns:
        Two clouds and the true motion, as those of ``mall``.

    Raises:
        ValueError: an argument out of its range.
        ImportError: Open3D is not installed.

    Example:
        >>> pair = road(seed=3, angular_step=2.0)
        >>> pair.source.points.shape[1], pair.T_target_source.shape
        (3, torch.Size([4, 4]))
    """
    return scan_twice(
        _ROAD, seed, baseline=baseline, angular_step=angular_step, range_noise=range_noise, relight=relight
    )


def _furnish(plan: StreetPlan, stations: list[Array], rng: np.random.Generator) -> Contents:
    """Pieces and people on lawns and pavements."""
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


def _park(plan: StreetPlan, stations: list[Array], rng: np.random.Generator) -> Contents:
    """Cars in the parking lanes; some leave and some come between the scans."""
    contents: Contents = ([], [])
    for side in SIDES:
        for x in plan.slots:
            vehicle, stays = car(rng) if rng.random() < 0.8 else van(rng), rng.random()
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
        pieces.append((outdoor.lamp_post(rng, tall), spot, 0.3))
    for spot in _row(plan, side, rng.uniform(16, 22), plan.front(side) - 0.9, 0.0, rng):
        pieces.append((plants.hedge(rng, rng.uniform(4, 9)), spot, 1.0))
    if rng.random() < 0.6:
        start, lawn = rng.uniform(-16, 10), plan.lawn_from(side)
        for k in range(int(rng.integers(2, 5))):
            pieces.append((outdoor.flag(rng), (start + 2.2 * k, side * (lawn + 0.4)), 0.6))
    if rng.random() < 0.5:
        place = (rng.uniform(-20, 20), side * (plan.lawn_from(side) + 0.3))
        pieces.append((outdoor.shelter(rng), place, 2.2))
    start = plan.crossing + rng.uniform(3.5, 5)
    pieces.append((outdoor.bollards(rng), (start + 2.6, side * (plan.kerb(side) + 0.4)), 2.8))
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


_ROAD = Environment(
    name="road",
    first_stream=100,
    plan=draw_plan,
    fixtures=(ground, houses),
    contents=(_furnish, _park),
    middle=lambda plan: ((-3, -0.3 * plan.width, 1.6), (3, 0.3 * plan.width, 1.8)),
    longest_baseline=30,
    light=lambda plan, weather, rng: daylight(weather, rng),
    probes=lambda plan: np.zeros((1, 3)),
    sunlit=0.4,
    scanner=LaserScanner(max_range=80.0, sensitivity=4.0),
)
