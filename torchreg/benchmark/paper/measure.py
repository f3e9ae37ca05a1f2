"""The rows of the paper's experiments: errors of every setting, place and method (1, 2, 3, 5), and times (4).

The paper says neither what its times cover nor on what machine. Three spans are measured: the descriptors of one cloud
alone, the same with its neighborhoods and normals, and the registration of a whole pair.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell
from torchreg.benchmark.core.timing import interleaved
from torchreg.benchmark.paper.methods import METHODS, options_of
from torchreg.benchmark.paper.places import Place
from torchreg.benchmark.paper.printed import FPFH, FUSED
from torchreg.benchmark.paper.settings import PaperSetting, RunSize, settings_of
from torchreg.descriptors.fuse import fuse
from torchreg.geometry.se3 import transform
from torchreg.metrics import inlier_ratio, pose_errors
from torchreg.preprocess import random_downsample
from torchreg.registration.describe import describe, description_of, oriented
from torchreg.registration.described import Description
from torchreg.registration.register import register
from torchreg.types import Clouds, Features, Neighborhoods

SPANS = ("descriptors", "with neighborhoods and normals", "whole registration")
"""What is timed, from the least to all."""

TIMED = (FPFH, FUSED)


class Trial(NamedTuple):
    """What one setting makes of one place: the clouds to register, and the truth."""

    source: Clouds
    target: Clouds
    T_target_source: Tensor


def error_cells(
    places: Sequence[Place], settings: Sequence[PaperSetting], size: RunSize, device: torch.device
) -> list[Cell]:
    """Every setting on every place of its kind, indoor or outdoor, by every method."""
    clouds_of = lru_cache(maxsize=1)(Place.clouds)

    @lru_cache(maxsize=1)
    def trial_of(place: Place, setting: PaperSetting) -> Trial:
        return trial(clouds_of(place), setting, place, size, device)

    def measure(place: Place, setting: PaperSetting, method: str) -> Row:
        return _errors(trial_of(place, setting), place, setting, method, size)

    return [
        Cell(
            key_of(setting, place, method),
            f"{place.name}, experiment {setting.experiment}, {setting.name}, {method}",
            partial(measure, place, setting, method),
        )
        for place in places
        for setting in settings
        if setting.outdoor == place.group.outdoor
        for method in METHODS
    ]


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


def key_of(setting: PaperSetting, place: Place, method: str) -> str:
    """The name of a row of errors."""
    return f"{setting.experiment}/{setting.name}/{place.name}/{method}"


def trial(
    clouds: tuple[Clouds, Clouds], setting: PaperSetting, place: Place, size: RunSize, device: torch.device
) -> Trial:
    """Draw the points and move the target to the initial pose.

    Draws are seeded by the place, not by the setting: all initial poses see the same points, and fewer points are a
    part of more, so that nothing but the setting differs.
    """
    source, target = (
        random_downsample(cloud, max(count // size.divisor, 1), generator=_generator(place.number, side)).to(device)
        for side, (cloud, count) in enumerate(zip(clouds, setting.points, strict=True))
    )
    T = setting.pose.matrix()
    return Trial(source, transform(target, T), T)


def _errors(one: Trial, place: Place, setting: PaperSetting, method: str, size: RunSize) -> Row:
    options = options_of(method, scale=place.scale, hypotheses=size.hypotheses, refit=place.group.refit)
    begin = time.perf_counter()
    result = register(one.source, one.target, options, seed=place.number)
    T = result.T_target_source.cpu()
    seconds = time.perf_counter() - begin
    truth = one.T_target_source[None].to(one.source.device)
    threshold = options.inlier_threshold
    ratio = inlier_ratio(result.source, result.target, result.correspondences, truth, threshold)
    errors = pose_errors(one.source, one.T_target_source, T[0])
    return {
        "experiment": setting.experiment,
        "setting": setting.name,
        "group": place.group.name,
        "place": place.name,
        "method": method,
        **errors._asdict(),
        "success": bool(result.success[0]),
        "points": [len(one.source.points), len(one.target.points)],
        "matches": len(result.correspondences.source),
        "inlier_ratio": float(ratio[0]),
        "threshold": threshold,
        "seconds": seconds,
        "T_target_source": T[0].tolist(),
    }


def _generator(place: int, side: int) -> torch.Generator:
    """A stream of its own for every place and side."""
    return torch.Generator().manual_seed(int(np.random.SeedSequence((place, side)).generate_state(1)[0]))


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
