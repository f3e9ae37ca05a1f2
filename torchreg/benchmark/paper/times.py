"""The rows of Experiment 4: times with and without color.

The paper says neither what its times cover nor on what machine. Three spans are measured: the descriptors of one cloud
alone, the same with its neighborhoods and normals, and the registration of a whole pair.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import torch

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell
from torchreg.benchmark.core.timing import interleaved
from torchreg.benchmark.paper.measure import Trial, trial
from torchreg.benchmark.paper.methods import options_of
from torchreg.benchmark.paper.places import Place
from torchreg.benchmark.paper.printed import FPFH, FUSED
from torchreg.benchmark.paper.settings import PaperSetting, RunSize, settings_of
from torchreg.descriptors.fuse import fuse
from torchreg.registration.describe import describe, description_of, oriented
from torchreg.registration.described import Description
from torchreg.registration.register import register
from torchreg.types import Clouds, Features, Neighborhoods

SPANS = ("descriptors", "with neighborhoods and normals", "whole registration")
"""What is timed, from the least to all."""

TIMED = (FPFH, FUSED)


def time_cells(place: Place, size: RunSize, device: torch.device) -> list[Cell]:
    """Both timed methods at every point count of Experiment 3; other numbers of threads are other rows."""
    clouds_of = lru_cache(maxsize=1)(Place.clouds)
    threads = f"{torch.get_num_threads()} threads"

    def measure(setting: PaperSetting) -> Row:
        return _times(trial(clouds_of(place), setting, place, size, device), place, setting, size)

    return [
        Cell(f"4/{setting.name}/{place.name}/{threads}", f"times, {setting.name} points", partial(measure, setting))
        for setting in settings_of(3)
    ]


def _times(one: Trial, place: Place, setting: PaperSetting, size: RunSize) -> Row:
    runs: dict[str, Callable[[], Any]] = {}
    for method in TIMED:
        options = options_of(method, scale=place.scale, hypotheses=size.hypotheses)
        description = description_of(options, colored=one.source.colors is not None)
        cloud, near = oriented(one.source, [description])
        runs[f"{SPANS[0]}/{method}"] = partial(_described, cloud, near, description)
        runs[f"{SPANS[1]}/{method}"] = partial(_from_points, one.source, description)
        runs[f"{SPANS[2]}/{method}"] = partial(register, one.source, one.target, options, seed=place.number)
    finished = {name: partial(_finished, run, one.source.device) for name, run in runs.items()}
    return {
        "experiment": 4,
        "setting": setting.name,
        "place": place.name,
        "points": len(one.source.points),
        "seconds": interleaved(finished, size.repeats),
    }


def _described(cloud: Clouds, near: Neighborhoods, description: Description) -> Features:
    """What is matched: FPFH, or FPFH and PCFH as one vector, of a cloud with normals."""
    return fuse(*describe(cloud, near, [description.descriptors]))


def _from_points(cloud: Clouds, description: Description) -> Features:
    return _described(*oriented(cloud, [description]), description)


def _finished(run: Callable[[], Any], device: torch.device) -> None:
    """Run, and wait for a device that works beside the processor."""
    run()
    if device.type == "cuda":
        torch.cuda.synchronize(device)
