"""Two scans of a simulated campus road, with the true motion between them.

A road is drawn from the seed, with buildings, trees, kerbs and parked cars along it, and scanned from two stations by
ray casting under the open sky. Between the scans some cars leave and others come, other people walk there, and the
weather changes. Windows, trees and lamp posts repeat in shape.
"""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.scene.quads import Quads
from torchreg.synthetic.scene.scanner import Scanner
from torchreg.synthetic.scene.weather import daylight, exposed_camera
from torchreg.synthetic.stations import check_options, scan_pair, two_stations
from torchreg.synthetic.street.furnishing import furnish, parked
from torchreg.synthetic.street.ground import ground
from torchreg.synthetic.street.plan import draw_plan
from torchreg.synthetic.street.rows import houses
from torchreg.types.scan_pair import ScanPair

# Each stage draws from a stream of its own, so that an option of one stage changes nothing in another.
_PLAN, _GROUND, _HOUSES, _FURNITURE, _CARS, _STATIONS, _WEATHER, _LIGHT, _CAMERAS, _NOISE = range(100, 110)


def road(
    seed: int = 0,
    *,
    baseline: float = 6.0,
    angular_step: float = 0.4,
    range_noise: float = 0.004,
    relight: float = 1.0,
) -> ScanPair:
    """Scan one simulated campus road from two stations.

    The same arguments give the same bits. All options but ``baseline`` leave the road and the stations as
    they are; ``baseline`` moves the stations, and takes away what would stand right beside them.

    Args:
        seed: which road; at least 0.
        baseline: meters between the two stations, in [0, 30]; 0 scans twice from one place, the scanner turned anew.
        angular_step: degrees between neighboring rays, in [0.05, 5]; the default gives some 180,000 points
            a scan.
        range_noise: meters, standard deviation of a range at 10 m on a surface that faces the scanner, in
            [0, 0.1].
        relight: how much light and camera differ between the scans, in [0, 2]; 0 not at all, 1 as between a
            sunny and a cloudy day.

    Returns:
        Two clouds, each in the frame of its own scanner, float32 in meters with colors in [0, 1] (steps of
        1/255) and the scanner at zero, and the true motion.

    Raises:
        ValueError: an argument out of its range.
        ImportError: Open3D is not there.

    Example:
        >>> pair = road(seed=3, angular_step=2.0)
        >>> pair.source.points.shape[1], pair.T_target_source.shape
        (3, torch.Size([4, 4]))
    """
    check_options(seed, baseline, angular_step, range_noise, relight, farthest=30)

    def stream(stage: int) -> np.random.Generator:
        return np.random.default_rng((seed, stage))

    plan = draw_plan(stream(_PLAN))
    at = stream(_STATIONS)
    middle = at.uniform((-3, -0.3 * plan.width, 1.6), (3, 0.3 * plan.width, 1.8))
    stations = two_stations(middle, baseline, at)
    lasting = [ground(plan, stream(_GROUND)), houses(plan, stream(_HOUSES))]
    things, cars = furnish(plan, stations, stream(_FURNITURE)), parked(plan, stations, stream(_CARS))
    weather = relight * float(stream(_WEATHER).choice([-1, 1]))
    lights = [daylight(sign * weather, stream(_LIGHT)) for sign in (1, -1)]
    settings = stream(_CAMERAS)
    return scan_pair(
        [Quads.join([*lasting, *things[k], *cars[k]]) for k in range(2)],
        lights,
        [exposed_camera(light, np.zeros((1, 3)), relight, settings, sunlit=0.4) for light in lights],
        stations,
        Scanner(angular_step=angular_step, range_noise=range_noise, max_range=80.0, sensitivity=4.0),
        seed=(seed, _NOISE),
        name=f"road-{seed}",
    )
