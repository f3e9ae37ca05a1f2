"""A kind of simulated place, and how any such place is scanned twice.

A plan is drawn from the seed; walls and ground follow from it, then two stations, then the loose pieces in either
scan. Light and camera differ between the scans. Each of these stages draws from a stream of its own, so that an option
of one stage changes nothing in another.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
import torch

from torchreg.errors import expect
from torchreg.seeds import numpy_seed
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.light import Light, exposed_camera
from torchreg.synthetic.scene.placing import Contents
from torchreg.synthetic.scene.quads import Quads
from torchreg.synthetic.scene.scanner import LaserScanner, Raycaster, pose, scan
from torchreg.types.scan_pair import ScanPair

Plan = TypeVar("Plan")


@dataclass(frozen=True, eq=False, kw_only=True)
class Environment(Generic[Plan]):
    """A kind of place: all that ``scan_twice`` needs to simulate one from a seed.

    Attributes:
        name: of its pairs, before the seed.
        first_stream: number of its first random stream; no other environment's streams may have the same numbers.
        plan: draws the sizes of a place.
        fixtures: draw what both scans see alike, such as the ground or walls; one stream each.
        contents: draw the loose pieces in the source scan and in the target scan, given ``T_world_scanner`` of both
            stations, beside which nothing may stand; one stream each.
        middle: lowest and highest place (3,) of the point halfway between the stations, meters.
        longest_baseline: meters.
        light: the light on a sunny (1) to cloudy (-1) day; makes the same draws whatever the weather.
        probes: places (P, 3) in meters where the camera meters the light.
        sunlit: share of the sun's light that the camera meters.
        scanner: of both scans; its angular step and range noise are options of a scan.
    """

    name: str
    first_stream: int
    plan: Callable[[np.random.Generator], Plan]
    fixtures: tuple[Callable[[Plan, np.random.Generator], Quads], ...]
    contents: tuple[Callable[[Plan, list[Array], np.random.Generator], Contents], ...]
    middle: Callable[[Plan], tuple[tuple[float, ...], tuple[float, ...]]]
    longest_baseline: float
    light: Callable[[Plan, float, np.random.Generator], Light]
    probes: Callable[[Plan], Array]
    sunlit: float
    scanner: LaserScanner


def scan_twice(
    environment: Environment[Plan],
    seed: int,
    *,
    baseline: float,
    angular_step: float,
    range_noise: float,
    relight: float,
) -> ScanPair:
    """Simulate one place of a kind and scan it from two stations; options and errors are those of ``mall``."""
    expect_within(baseline, "baseline", "meters", 0, environment.longest_baseline)
    expect_within(angular_step, "angular_step", "degrees", 0.05, 5)
    expect_within(range_noise, "range_noise", "meters", 0, 0.1)
    expect_within(relight, "relight", "a number", 0, 2)
    stages = 6 + len(environment.fixtures) + len(environment.contents)
    streams = [(numpy_seed(seed), environment.first_stream + stage) for stage in range(stages)]
    of_plan, *of_parts, of_stations, of_weather, of_light, of_cameras, of_noise = streams
    of_fixtures, of_contents = of_parts[: len(environment.fixtures)], of_parts[len(environment.fixtures) :]
    rng = np.random.default_rng

    plan = environment.plan(rng(of_plan))
    fixtures = [draw(plan, rng(part)) for draw, part in zip(environment.fixtures, of_fixtures, strict=True)]
    stations = _stations(environment.middle(plan), baseline, rng(of_stations))
    contents = [draw(plan, stations, rng(part)) for draw, part in zip(environment.contents, of_contents, strict=True)]
    weather = relight * float(rng(of_weather).choice([-1, 1]))
    lights = [environment.light(plan, sign * weather, rng(of_light)) for sign in (1, -1)]
    errors, probes = rng(of_cameras), environment.probes(plan)
    cameras = [exposed_camera(light, probes, relight, errors, sunlit=environment.sunlit) for light in lights]
    scanner = replace(environment.scanner, angular_step=angular_step, range_noise=range_noise)

    clouds = []
    for k in range(2):
        quads = Quads.join([*fixtures, *(piece for part in contents for piece in part[k])])
        clouds.append(scan(Raycaster(quads), lights[k], cameras[k], stations[k], scanner, seed=(*of_noise, k)))
    T_world_source, T_world_target = stations
    return ScanPair(
        source=clouds[0],
        target=clouds[1],
        T_target_source=torch.from_numpy(np.linalg.inv(T_world_target) @ T_world_source),
        name=f"{environment.name}-{seed}",
    )


def expect_within(value: float, name: str, unit: str, low: float, high: float) -> None:
    """Check that an option is a number in [low, high]; ``unit`` is part of the message."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    expect(number and low <= value <= high, name, f"{unit} in [{low}, {high}]", value)


def _stations(
    middle: tuple[tuple[float, ...], tuple[float, ...]], baseline: float, rng: np.random.Generator
) -> list[Array]:
    """``T_world_scanner`` (4, 4) of two stations ``baseline`` meters apart, mostly along x; 0 turns one place anew."""
    center = rng.uniform(*middle)
    apart = min(baseline, 4.0) * rng.uniform((-0.3, -0.03), (0.3, 0.03))  # across and up
    half = 0.5 * np.array([math.sqrt(baseline**2 - apart @ apart), *apart])
    stations = []
    for position in (center - half, center + half):
        yaw, tilt, tilt_heading = rng.uniform((-math.pi, 0, -math.pi), (math.pi, math.radians(2), math.pi))
        stations.append(pose(position, yaw, tilt, tilt_heading))
    return stations
