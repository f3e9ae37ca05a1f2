"""Two scanner stations in a simulated place, and the pair of scans taken from them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from torchreg.errors import at_least, expect
from torchreg.synthetic.scene.arrays import Array
from torchreg.synthetic.scene.light import Camera, Light
from torchreg.synthetic.scene.quads import Quads
from torchreg.synthetic.scene.scanner import Scan, Scanner, pose, scan
from torchreg.types.clouds import Clouds
from torchreg.types.scan_pair import ScanPair


def check_options(
    seed: int, baseline: float, angular_step: float, range_noise: float, relight: float, *, farthest: float
) -> None:
    """Check the options that all simulated places take; ``farthest`` bounds the baseline, meters.

    Raises:
        ValueError: an option out of its range.
    """
    at_least(seed, "seed", 0)
    _expect_within(baseline, "baseline", "meters", 0, farthest)
    _expect_within(angular_step, "angular_step", "degrees", 0.05, 5)
    _expect_within(range_noise, "range_noise", "meters", 0, 0.1)
    _expect_within(relight, "relight", "a number", 0, 2)


def two_stations(middle: Array, baseline: float, rng: np.random.Generator) -> list[Array]:
    """``T_world_scanner`` (4, 4) of two stations ``baseline`` meters apart, mostly along x.

    Args:
        middle: (3,) meters, halfway between both.
        baseline: meters; 0 puts both in one place, turned differently.
        rng: the same draws whatever the baseline.
    """
    apart = min(baseline, 4.0) * rng.uniform((-0.3, -0.03), (0.3, 0.03))  # across and up
    half = 0.5 * np.array([math.sqrt(baseline**2 - apart @ apart), *apart])
    stations = []
    for position in (middle - half, middle + half):
        yaw, tilt, tilt_heading = rng.uniform((-math.pi, 0, -math.pi), (math.pi, math.radians(2), math.pi))
        stations.append(pose(position, yaw, tilt, tilt_heading))
    return stations


def scan_pair(
    contents: Sequence[Quads],
    lights: Sequence[Light],
    cameras: Sequence[Camera],
    stations: Sequence[Array],
    scanner: Scanner,
    *,
    seed: tuple[int, ...],
    name: str,
) -> ScanPair:
    """Scan a place twice: contents, light, camera and pose of the source scan, then of the target scan.

    Args:
        contents: all that the scan sees.
        lights: the light at the time of the scan.
        cameras: the camera of the scan.
        stations: ``T_world_scanner`` (4, 4).
        scanner: of both scans.
        seed: of the noise of both scans.
        name: of the pair.
    """
    clouds = [_cloud(scan(contents[k], lights[k], cameras[k], stations[k], scanner, seed=(*seed, k))) for k in range(2)]
    T_world_source, T_world_target = stations
    return ScanPair(
        source=clouds[0],
        target=clouds[1],
        T_target_source=torch.from_numpy(np.linalg.inv(T_world_target) @ T_world_source),
        name=name,
    )


def _cloud(scanned: Scan) -> Clouds:
    return Clouds(
        points=torch.from_numpy(scanned.points.astype(np.float32)),
        colors=torch.from_numpy(scanned.colors).to(torch.float32) / 255,
        viewpoint=torch.zeros(1, 3),
    )


def _expect_within(value: float, name: str, unit: str, low: float, high: float) -> None:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    expect(number and low <= value <= high, name, f"{unit} in [{low}, {high}]", value)
