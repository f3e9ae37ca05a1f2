"""Two scans of a simulated shopping mall, with the true motion between them.

A hall is drawn from the seed, furnished, and scanned from two stations by ray casting. Between the scans some
cartons are moved, other people stand around, and the light changes. Columns, fronts and signs repeat in shape.
Most surfaces are white, gray or beige in most halls; the colored share differs from hall to hall.
"""

from __future__ import annotations

import math

import numpy as np

from torchreg.entry import entry
from torchreg.synthetic.architecture.hall import HallPlan, ceiling, columns, draw_plan, end_wall, floor
from torchreg.synthetic.architecture.shops import bay
from torchreg.synthetic.furniture import indoor
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.environment import Environment, scan_twice
from torchreg.synthetic.scene.light import Light, indoor_light
from torchreg.synthetic.scene.placing import FIXED, MOVED, ONLY_SOURCE, ONLY_TARGET, Contents, Pieces, scatter
from torchreg.synthetic.scene.quads import Quads, up
from torchreg.synthetic.scene.scanner import LaserScanner
from torchreg.types.scan_pair import ScanPair

_FURNITURE = (
    Pieces(indoor.kiosk, 1.9, 3, FIXED),
    Pieces(indoor.bench, 1.0, 5, FIXED),
    Pieces(indoor.planter, 0.6, 7, FIXED),
    Pieces(indoor.board, 0.5, 4, FIXED),
    Pieces(indoor.litter_bin, 0.3, 4, FIXED),
    Pieces(indoor.cartons, 0.5, 5, FIXED),
    Pieces(indoor.cartons, 0.5, 5, MOVED),
    Pieces(indoor.person, 0.4, 6, ONLY_SOURCE),
    Pieces(indoor.person, 0.4, 6, ONLY_TARGET),
)


@entry
def mall(
    seed: int = 0,
    *,
    baseline: float = 6.0,
    angular_step: float = 0.4,
    range_noise: float = 0.004,
    relight: float = 1.0,
) -> ScanPair:
    """Scan one simulated mall from two stations.

    The same arguments give the same bits. ``baseline`` moves the stations and removes what would stand right beside
    them; all other options leave hall and stations alone.

    Args:
        seed: which hall; any integer.
        baseline: meters between the two stations, in [0, 16]; 0 scans twice from one place, the scanner turned.
        angular_step: degrees between neighboring rays, in [0.05, 5]; the default gives some 280,000 points
            a scan.
        range_noise: meters, standard deviation of a range at 10 m on a surface that faces the scanner, in
            [0, 0.1].
        relight: how much illumination and camera differ between the scans, in [0, 2]; 0 not at all, 1 as
            between a sunny and a cloudy day.

    Returns:
        Two clouds, each in the frame of its own scanner, float32 in meters with colors in [0, 1] (steps of
        1/255) and the scanner at zero, and the true motion.

    Raises:
        ValueError: an argument out of its range.
        ImportError: Open3D is not installed.

    Example:
        >>> pair = mall(seed=3, angular_step=2.0)
        >>> pair.source.points.shape[1], pair.T_target_source.shape
        (3, torch.Size([4, 4]))
    """
    return scan_twice(
        _MALL, seed, baseline=baseline, angular_step=angular_step, range_noise=range_noise, relight=relight
    )


def _building(plan: HallPlan, rng: np.random.Generator) -> Quads:
    parts = [floor(plan, rng), ceiling(plan, rng), columns(plan, rng)]
    for side in (-1, 1):
        yaw = math.pi if side < 0 else 0.0
        parts += [bay(plan, rng).placed(x, side * plan.width / 2, yaw=yaw) for x in plan.bay_x]
        parts.append(end_wall(plan, rng).placed(side * plan.length / 2, 0, yaw=-side * math.pi / 2))
    return Quads.join(parts)


def _furnish(plan: HallPlan, stations: list[Array], rng: np.random.Generator) -> Contents:
    """Pieces of furniture and people, clear of the columns."""

    def anywhere(radius: float, rng: np.random.Generator) -> Array:
        half = np.array([plan.length / 2, plan.width / 2]) - radius - 0.5
        return rng.uniform(-half, half, (100, 2))

    taken = np.pad(plan.columns, ((0, 0), (0, 1)), constant_values=plan.column_size)  # (N, 3): x, y, radius
    return scatter(_FURNITURE, anywhere, taken, stations, rng)


def _light(plan: HallPlan, weather: float, rng: np.random.Generator) -> Light:
    """Lamps along the ceiling and one in each shop, and daylight through the skylight."""
    inside_y = np.repeat([-1, 1], plan.bays) * (plan.width + plan.depth) / 2
    inside = np.column_stack((np.tile(plan.bay_x, 2), inside_y, np.full(2 * plan.bays, plan.opening - 0.2)))
    lamps = np.concatenate((plan.lamps, inside))
    power = np.repeat([12.0, 2.5], [len(plan.lamps), len(inside)])
    return indoor_light(lamps, power, up(plan.height), plan.skylight[0] * plan.skylight[1], weather, rng)


def _probes(plan: HallPlan) -> Array:
    """Places (24, 3) spread over the hall, 1 m above the floor."""
    x, y = np.meshgrid(np.linspace(-0.4, 0.4, 6) * plan.length, np.linspace(-0.4, 0.4, 4) * plan.width)
    return np.stack((x, y, 0 * x + 1.0), axis=-1).reshape(-1, 3)


_MALL = Environment(
    name="mall",
    first_stream=0,
    plan=draw_plan,
    fixtures=(_building,),
    contents=(_furnish,),
    middle=lambda plan: ((-1.5, -0.7, 1.5), (1.5, 0.7, 1.7)),
    longest_baseline=16,
    light=_light,
    probes=_probes,
    sunlit=0.1,
    scanner=LaserScanner(),
)
