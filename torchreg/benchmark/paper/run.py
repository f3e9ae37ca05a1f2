"""Experiments 1, 2, 3 and 5: every setting on every place by every method."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchreg.benchmark.paper.methods import METHODS, options_of
from torchreg.benchmark.paper.places import Place
from torchreg.benchmark.paper.settings import Setting
from torchreg.benchmark.paper.size import Size
from torchreg.benchmark.rows import Row, Rows
from torchreg.geometry.se3 import transform
from torchreg.metrics import inlier_ratio, pose_errors
from torchreg.preprocess import random_downsample
from torchreg.registration.describe import downsample
from torchreg.registration.register import register
from torchreg.types import Clouds


class Trial(NamedTuple):
    """What one setting makes of one place: the clouds to register, and the truth."""

    source: Clouds
    target: Clouds
    T_target_source: Tensor


def key_of(setting: Setting, place: Place, method: str) -> str:
    """The name of one measurement."""
    return f"{setting.experiment}/{setting.name}/{place.name}/{method}"


def measure(
    places: Sequence[Place],
    settings: Sequence[Setting],
    rows: Rows,
    size: Size,
    device: torch.device,
    report: Callable[[str], None],
) -> None:
    """Fill in the rows that are not there yet.

    Args:
        places: where.
        settings: of the experiments; a place takes part in those of its kind, indoor or outdoor.
        rows: what has been measured so far.
        size: of the run.
        device: where to compute.
        report: is told of every place before it begins.
    """
    for number, place in enumerate(places, start=1):
        asked = [
            (setting, [method for method in METHODS if key_of(setting, place, method) not in rows])
            for setting in settings
            if setting.outdoor == place.group.outdoor
        ]
        if not any(missing for _, missing in asked):
            continue
        report(f"{place.name} ({number} of {len(places)})")
        clouds = place.clouds()
        for setting, missing in asked:
            if missing:
                one = trial(clouds, setting, place, size, device)
                for method in missing:
                    rows.add(_measured(one, setting, place, method, size))


def trial(clouds: tuple[Clouds, Clouds], setting: Setting, place: Place, size: Size, device: torch.device) -> Trial:
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


def _measured(one: Trial, setting: Setting, place: Place, method: str, size: Size) -> Row:
    options = options_of(method, scale=place.scale, hypotheses=size.hypotheses, refit=place.group.refit)
    begin = time.perf_counter()
    result = register(one.source, one.target, options, seed=place.number)
    T = result.T_target_source.cpu()
    seconds = time.perf_counter() - begin
    truth = one.T_target_source[None].to(one.source.device)
    threshold = options.ransac.inlier_threshold
    # the matches speak of the points in the order in which register took them
    source, target = (downsample(cloud, result.options) for cloud in (one.source, one.target))
    ratio = inlier_ratio(source, target, result.correspondences, truth, threshold)
    errors = pose_errors(one.source, one.T_target_source, T[0])
    return {
        "key": key_of(setting, place, method),
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
    """Another stream for every place and side."""
    seed = int(np.random.SeedSequence((place, side)).generate_state(1)[0])
    return torch.Generator().manual_seed(seed)
