"""Scenes of any number of points for a device: points between neighboring points of two simulated scans."""

from __future__ import annotations

from functools import lru_cache

import torch

from torchreg.benchmark.speed.scene import NEIGHBORS, TimedCloud, TimedScene
from torchreg.datasets import mall
from torchreg.neighborhoods import neighbors
from torchreg.preprocess import random_downsample
from torchreg.registration.spacing import spacing
from torchreg.seeds import generator_of
from torchreg.types import Clouds

_NEAR = 5  # the points that a new one lies between: one and its nearest four


@lru_cache(maxsize=1)
def device_scene(points: int, device: torch.device) -> TimedScene:
    """``points`` a cloud, on the device, with lengths in their spacing."""
    sides = [filled(scan, points, seed) for seed, scan in enumerate(_scans())]
    # on a surface the spacing goes with the root of the number of points
    few = [random_downsample(side, min(points, 20_000)) for side in sides]
    apart = max(float(spacing(side)[0]) for side in few) * (min(points, 20_000) / points) ** 0.5
    return TimedScene(*(TimedCloud(side.to(device), apart, NEIGHBORS) for side in sides))


def filled(cloud: Clouds, points: int, seed: int) -> Clouds:
    """So many points out of one cloud: some of its own, or between its own and their neighbors where it has too few."""
    generator = generator_of(seed)
    if points <= len(cloud.points):
        return random_downsample(cloud, points, generator=generator)
    apart = float(spacing(cloud)[0])
    near = neighbors(cloud, 3 * apart, _NEAR)
    one = torch.randint(len(cloud.points), (points,), generator=generator)
    other = near.index[one, torch.randint(_NEAR, (points,), generator=generator)]
    share = torch.rand(points, 1, generator=generator)
    colors = None if cloud.colors is None else cloud.colors[one].lerp(cloud.colors[other], share)
    return Clouds(points=cloud.points[one].lerp(cloud.points[other], share), colors=colors, viewpoint=cloud.viewpoint)


@lru_cache(maxsize=1)
def _scans() -> tuple[Clouds, Clouds]:
    pair = mall(seed=0, angular_step=0.4)
    return pair.source, pair.target
