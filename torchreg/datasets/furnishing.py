"""Which pieces of furniture stand where in the hall, and in which of the two scans."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from torchreg.datasets import furniture
from torchreg.datasets.hall import HallPlan
from torchreg.datasets.scene.arrays import Array
from torchreg.datasets.scene.quads import Quads

# For each place that a piece takes, the scans that find it there.
_FIXED, _MOVED, _ONLY_SOURCE, _ONLY_TARGET = ((0, 1),), ((0,), (1,)), ((0,),), ((1,),)


class _Kind(NamedTuple):
    make: Callable[[np.random.Generator], Quads]
    radius: float  # meters that it takes around its middle
    number: int
    places: tuple[tuple[int, ...], ...]


_KINDS = (
    _Kind(furniture.kiosk, 1.9, 3, _FIXED),
    _Kind(furniture.bench, 1.0, 5, _FIXED),
    _Kind(furniture.planter, 0.6, 7, _FIXED),
    _Kind(furniture.board, 0.5, 4, _FIXED),
    _Kind(furniture.litter_bin, 0.3, 4, _FIXED),
    _Kind(furniture.cartons, 0.5, 5, _FIXED),
    _Kind(furniture.cartons, 0.5, 5, _MOVED),
    _Kind(furniture.person, 0.4, 6, _ONLY_SOURCE),
    _Kind(furniture.person, 0.4, 6, _ONLY_TARGET),
)
_CLEARANCE = 0.8  # meters around a tripod


def furnish(plan: HallPlan, stations: list[Array], rng: np.random.Generator) -> tuple[list[Quads], list[Quads]]:
    """The pieces that the source scan and the target scan see.

    Args:
        plan: the hall, with columns to keep clear of.
        stations: poses (4, 4) of the scanners; what would stand right beside one is left out of both scans.
        rng: the same draws wherever the stations are.
    """
    taken = np.pad(plan.columns, ((0, 0), (0, 1)), constant_values=plan.column_size)  # (N, 3): x, y, radius
    contents: tuple[list[Quads], list[Quads]] = ([], [])
    for kind in _KINDS:
        for _ in range(kind.number):
            piece = kind.make(rng)
            for seen_by in kind.places:
                yaw = 0.5 * math.pi * rng.integers(4) + rng.uniform(-0.2, 0.2)
                spot = _free_spot(plan, taken, kind.radius, rng)
                if spot is None:
                    continue
                taken = np.vstack((taken, (*spot, kind.radius)))
                if all(math.dist(pose[:2, 3], spot) > kind.radius + _CLEARANCE for pose in stations):
                    for k in seen_by:
                        contents[k].append(piece.placed(spot[0], spot[1], yaw=yaw))
    return contents


def _free_spot(plan: HallPlan, taken: Array, radius: float, rng: np.random.Generator) -> Array | None:
    """The first of a hundred random places (2,) that keeps clear of all that is ``taken``."""
    half = np.array([plan.length / 2, plan.width / 2]) - radius - 0.5
    places = rng.uniform(-half, half, (100, 2))
    apart = np.linalg.norm(places[:, None] - taken[:, :2], axis=2)  # (100, N)
    free = np.flatnonzero((apart > taken[:, 2] + radius).all(axis=1))
    return np.asarray(places[free[0]]) if len(free) else None
