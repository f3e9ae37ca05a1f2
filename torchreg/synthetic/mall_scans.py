"""Two scans of a simulated shopping mall, with the true motion between them.

A hall is drawn from the seed, furnished, and scanned from two stations by ray casting. Between the scans some
cartons are moved, other people stand around, and the light changes. Columns, fronts and signs repeat in shape.
Most of what is seen is white, gray or beige in most halls; how much is colored differs from hall to hall.
"""

from __future__ import annotations

import math

import numpy as np

from torchreg.synthetic.furnishing import furnish
from torchreg.synthetic.hall import HallPlan, ceiling, columns, draw_plan, end_wall, floor
from torchreg.synthetic.scene.arrays import Array
from torchreg.synthetic.scene.light import Light
from torchreg.synthetic.scene.quads import Quads, up
from torchreg.synthetic.scene.scanner import Scanner
from torchreg.synthetic.scene.weather import exposed_camera, hall_light
from torchreg.synthetic.shops import bay
from torchreg.synthetic.stations import check_options, scan_pair, two_stations
from torchreg.types.scan_pair import ScanPair

# Each stage draws from a stream of its own, so that an option of one stage changes nothing in another.
_PLAN, _BUILDING, _FURNITURE, _STATIONS, _WEATHER, _LIGHT, _CAMERAS, _NOISE = range(8)


def mall(
    seed: int = 0,
    *,
    baseline: float = 6.0,
    angular_step: float = 0.4,
    range_noise: float = 0.004,
    relight: float = 1.0,
) -> ScanPair:
    """Scan one simulated mall from two stations.

    The same arguments give the same bits. All options but ``baseline`` leave the hall and the stations as
    they are; ``baseline`` moves the stations, and takes away what would stand right beside them.

    Args:
        seed: which hall; at least 0.
        baseline: meters between the two stations, in [0, 16]; 0 scans twice from one place, the scanner turned anew.
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
        ImportError: Open3D is not there.

    Example:
        >>> pair = mall(seed=3, angular_step=2.0)
        >>> pair.source.points.shape[1], pair.T_target_source.shape
        (3, torch.Size([4, 4]))
    """
    check_options(seed, baseline, angular_step, range_noise, relight, farthest=16)

    def stream(stage: int) -> np.random.Generator:
        return np.random.default_rng((seed, stage))

    plan = draw_plan(stream(_PLAN))
    building = _building(plan, stream(_BUILDING))
    at = stream(_STATIONS)
    stations = two_stations(at.uniform((-1.5, -0.7, 1.5), (1.5, 0.7, 1.7)), baseline, at)
    contents = furnish(plan, stations, stream(_FURNITURE))
    weather = relight * float(stream(_WEATHER).choice([-1, 1]))
    lights = [_light(plan, sign * weather, stream(_LIGHT)) for sign in (1, -1)]
    scanner = Scanner(angular_step=angular_step, range_noise=range_noise)
    probes = _grid(plan, height=1.0)
    settings = stream(_CAMERAS)
    return scan_pair(
        [Quads.join([building, *seen]) for seen in contents],
        lights,
        [exposed_camera(light, probes, relight, settings) for light in lights],
        stations,
        scanner,
        seed=(seed, _NOISE),
        name=f"mall-{seed}",
    )


def _building(plan: HallPlan, rng: np.random.Generator) -> Quads:
    parts = [floor(plan, rng), ceiling(plan, rng), columns(plan, rng)]
    for side in (-1, 1):
        yaw = math.pi if side < 0 else 0.0
        parts += [bay(plan, rng).placed(x, side * plan.width / 2, yaw=yaw) for x in plan.bay_x]
        parts.append(end_wall(plan, rng).placed(side * plan.length / 2, 0, yaw=-side * math.pi / 2))
    return Quads.join(parts)


def _light(plan: HallPlan, weather: float, rng: np.random.Generator) -> Light:
    """Lamps along the ceiling and one in each shop, and daylight through the skylight."""
    inside_y = np.repeat([-1, 1], plan.bays) * (plan.width + plan.depth) / 2
    inside = np.column_stack((np.tile(plan.bay_x, 2), inside_y, np.full(2 * plan.bays, plan.opening - 0.2)))
    lamps = np.concatenate((plan.lamps, inside))
    power = np.repeat([12.0, 2.5], [len(plan.lamps), len(inside)])
    return hall_light(lamps, power, up(plan.height), plan.skylight[0] * plan.skylight[1], weather, rng)


def _grid(plan: HallPlan, height: float) -> Array:
    """Places (24, 3) spread over the hall."""
    x, y = np.meshgrid(np.linspace(-0.4, 0.4, 6) * plan.length, np.linspace(-0.4, 0.4, 4) * plan.width)
    return np.stack((x, y, 0 * x + height), axis=-1).reshape(-1, 3)
