"""Experiment 4: what the color block costs beside FPFH.

The paper says neither what its times cover nor on what machine. Three spans are measured: the descriptors of one cloud
alone, the same with its neighborhoods and normals, and the registration of a whole pair.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch

from torchreg.benchmark.paper.methods import options_of
from torchreg.benchmark.paper.places import Place
from torchreg.benchmark.paper.printed import FPFH, FUSED
from torchreg.benchmark.paper.run import trial
from torchreg.benchmark.paper.settings import settings_of
from torchreg.benchmark.paper.size import Size
from torchreg.benchmark.rows import Rows
from torchreg.benchmark.timing import interleaved
from torchreg.descriptors.color import color_values
from torchreg.registration.describe import describe, fused, oriented
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.register import register
from torchreg.types import Clouds, Features, Neighborhoods

SPANS = ("descriptors", "with neighborhoods and normals", "whole registration")
"""What is timed, from the least to all."""

TIMED = (FPFH, FUSED)


def time_key(setting: str, place: Place) -> str:
    """The name of the times at one point count: those on more threads are others."""
    return f"4/{setting}/{place.name}/{torch.get_num_threads()} threads"


def measure_times(place: Place, rows: Rows, size: Size, device: torch.device) -> None:
    """Time both methods at every point count of Experiment 3 on one place, where that is not done yet."""
    missing = [setting for setting in settings_of(3) if time_key(setting.name, place) not in rows]
    if not missing:
        return
    clouds = place.clouds()
    for setting in missing:
        one = trial(clouds, setting, place, size, device)
        runs: dict[str, Callable[[], Any]] = {}
        for method in TIMED:
            options = options_of(method, scale=place.scale, hypotheses=size.hypotheses)
            cloud, near = oriented(one.source, [options])
            runs[f"{SPANS[0]}/{method}"] = partial(described, cloud, near, options)
            runs[f"{SPANS[1]}/{method}"] = partial(_from_points, one.source, options)
            runs[f"{SPANS[2]}/{method}"] = partial(register, one.source, one.target, options, seed=place.number)
        finished = {name: partial(_finished, run, device) for name, run in runs.items()}
        seconds = interleaved(finished, size.repeats)
        rows.add(
            {
                "key": time_key(setting.name, place),
                "experiment": 4,
                "setting": setting.name,
                "place": place.name,
                "points": len(one.source.points),
                "seconds": seconds,
            }
        )


def described(cloud: Clouds, near: Neighborhoods, options: RegistrationOptions) -> Features:
    """What is matched: FPFH, or FPFH and PCFH as one vector, of a cloud with normals."""
    values = color_values(cloud, options.equalization) if options.color else None
    return fused(describe(cloud, near, [options], values, options.color), options.color, options.color_weights)


def _from_points(cloud: Clouds, options: RegistrationOptions) -> Features:
    return described(*oriented(cloud, [options]), options)


def _finished(run: Callable[[], Any], device: torch.device) -> None:
    """Run, and wait for the device where it works on its own."""
    run()
    if device.type == "cuda":
        torch.cuda.synchronize(device)
