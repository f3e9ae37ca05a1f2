"""Many small pairs in one call, against a loop over single calls."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial

import torch

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell
from torchreg.benchmark.speed.side_by_side import side_by_side
from torchreg.datasets import mall
from torchreg.preprocess import random_downsample
from torchreg.registration.register import register
from torchreg.types import Clouds

BATCHES = "batches"
CAPTION = "Random choices of the points of two stations in some simulated malls, all pairs in one call and one by one:"

_PAIRS, _POINTS = 256, 1000
_QUICK_PAIRS, _QUICK_POINTS = 4, 200
_MALLS = 16
_EFFORTS = ("plain", "fast", "balanced")


def cells(repeats: int, *, quick: bool) -> Iterator[Cell]:
    """One row per effort."""
    pairs, points = (_QUICK_PAIRS, _QUICK_POINTS) if quick else (_PAIRS, _POINTS)
    for effort in _EFFORTS:
        case = f"{pairs} pairs of {points:,} points, {effort}"
        yield Cell(case, case, partial(_measured, case, pairs, points, effort, repeats))


@cache
def small_pairs(pairs: int, points: int) -> tuple[Clouds, Clouds]:
    """So many pairs of so many points a cloud, both sides packed."""
    malls = [mall(seed=seed, angular_step=1.2) for seed in range(min(_MALLS, pairs))]
    sides: tuple[list[Clouds], list[Clouds]] = ([], [])
    for number in range(pairs):
        pair = malls[number % len(malls)]
        for side, cloud in zip(sides, (pair.source, pair.target), strict=True):
            side.append(random_downsample(cloud, points, generator=torch.Generator().manual_seed(number)))
    return Clouds.pack(sides[0]), Clouds.pack(sides[1])


def _measured(case: str, pairs: int, points: int, effort: str, repeats: int) -> Row:
    source, target = small_pairs(pairs, points)
    single = list(zip(source.unpack(), target.unpack(), strict=True))
    runs = {
        "loop": lambda: [register(one, other, effort=effort) for one, other in single],
        "one call": lambda: register(source, target, effort=effort),
    }
    return side_by_side(BATCHES, case, runs, repeats)
