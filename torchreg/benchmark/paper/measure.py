"""The rows of Experiments 1, 2, 3 and 5: the errors of every setting, place, way and method, of several runs of RANSAC.

Scans are made once per place, points drawn and described once per setting, and matched once per method and kind of
normals: only RANSAC runs again.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell
from torchreg.benchmark.paper.methods import METHODS, options_of
from torchreg.benchmark.paper.places import Place
from torchreg.benchmark.paper.settings import RUNS, PaperSetting, RunSize
from torchreg.benchmark.paper.sides import MatchedSide, described, matched
from torchreg.benchmark.paper.ways import MAIN_WAYS, Procedure
from torchreg.geometry.se3 import apply_rotation, rigid, transform
from torchreg.metrics import inlier_ratio, pose_errors
from torchreg.preprocess import random_downsample
from torchreg.seeds import generator_of
from torchreg.solvers import Solver, base_seed
from torchreg.solvers.batch import poses_of_pairs
from torchreg.types import Clouds, Correspondences


class Trial(NamedTuple):
    """What one setting makes of one place: the clouds to register, and the truth."""

    source: Clouds
    target: Clouds
    T_target_source: Tensor


class _Pair(NamedTuple):
    """The same, described."""

    trial: Trial
    source: MatchedSide
    target: MatchedSide


def error_cells(
    places: Sequence[Place], settings: Sequence[PaperSetting], size: RunSize, device: torch.device
) -> list[Cell]:
    """Every setting on every place of its kind, indoor or outdoor, in the place's ways by every method.

    Places come one after another, all settings of each; what goes beyond the paper comes after everything else.
    """
    clouds_of = lru_cache(maxsize=1)(Place.clouds)

    @lru_cache(maxsize=1)
    def source_of(place: Place, count: int) -> tuple[Clouds, MatchedSide]:
        cloud = _drawn(clouds_of(place)[0], count, place, 0, size).to(device)
        return cloud, described(cloud, place.scale)

    @lru_cache(maxsize=1)
    def pair_of(place: Place, setting: PaperSetting) -> _Pair:
        source, side = source_of(place, setting.points[0])
        one = trial(clouds_of(place), setting, place, size, device)
        return _Pair(one._replace(source=source), side, described(one.target, place.scale))

    @lru_cache(maxsize=2 * len(METHODS))
    def matches_of(place: Place, setting: PaperSetting, method: str, turned: bool) -> Correspondences:
        pair = pair_of(place, setting)
        return matched(pair.source, pair.target, options_of(method, scale=place.scale), turned=turned)

    def measure(place: Place, setting: PaperSetting, way: Procedure, method: str) -> Row:
        matches = matches_of(place, setting, method, way.turned)
        return _errors(pair_of(place, setting), matches, place, setting, way, method, size)

    wanted = [
        (place, setting, way)
        for place in places
        for setting in settings
        if setting.outdoor == place.group.outdoor
        for way in place.ways
    ]
    wanted.sort(key=lambda each: not (each[0].group.paper and each[2] in MAIN_WAYS))
    return [
        Cell(
            key_of(setting, place, way, method),
            f"{place.name}, experiment {setting.experiment}, {setting.name}, {way.name}, {method}",
            partial(measure, place, setting, way, method),
        )
        for place, setting, way in wanted
        for method in METHODS
    ]


def key_of(setting: PaperSetting, place: Place, way: Procedure, method: str) -> str:
    """The name of a row of errors."""
    return f"{setting.experiment}/{setting.name}/{place.name}/{way.name}/{method}"


def trial(
    clouds: tuple[Clouds, Clouds], setting: PaperSetting, place: Place, size: RunSize, device: torch.device
) -> Trial:
    """Draw the points and move the target to the initial pose.

    Draws are seeded by the place, not by the setting: all initial poses see the same points, and fewer points are a
    part of more, so that nothing but the setting differs.
    """
    source, target = (
        _drawn(cloud, count, place, side, size).to(device)
        for side, (cloud, count) in enumerate(zip(clouds, setting.points, strict=True))
    )
    T = setting.pose.matrix()
    return Trial(source, transform(target, T), T)


def _drawn(cloud: Clouds, count: int, place: Place, side: int, size: RunSize) -> Clouds:
    generator = torch.Generator().manual_seed(stream(place.number, side))
    return random_downsample(cloud, max(count // size.divisor, 1), generator=generator)


def _errors(
    pair: _Pair,
    matches: Correspondences,
    place: Place,
    setting: PaperSetting,
    way: Procedure,
    method: str,
    size: RunSize,
) -> Row:
    """One row: every error is a list of one number per run of RANSAC; the transform is that of the first."""
    options = options_of(method, scale=place.scale, hypotheses=size.hypotheses, refit=way.refit)
    one, source, target = pair.trial, pair.source.cloud, pair.target.cloud
    draws = [base_seed(generator_of(stream(place.number, 2 + run))) for run in range(RUNS)]  # as ``register`` does
    poses = [_best_pose(source, target, matches, options.solver, draw) for draw in draws]
    errors = [pose_errors(one.source, one.T_target_source, T) for T in poses]
    truth = one.T_target_source[None].to(one.source.device)
    return {
        "experiment": setting.experiment,
        "setting": setting.name,
        "group": place.group.name,
        "place": place.name,
        "way": way.name,
        "method": method,
        **{name: [getattr(error, name) for error in errors] for name in errors[0]._fields},
        "points": [len(one.source.points), len(one.target.points)],
        "matches": len(matches.source),
        "inlier_ratio": float(inlier_ratio(source, target, matches, truth, options.inlier_threshold)[0]),
        "threshold": options.inlier_threshold,
        "T_target_source": poses[0].tolist(),
    }


def _best_pose(source: Clouds, target: Clouds, matches: Correspondences, solver: Solver, seed: int) -> Tensor:
    """``T_target_source`` (4, 4) that most matches agree on, as ``solve`` has it; the identity where there is none."""
    poses = poses_of_pairs(source, target, matches, [solver], seed)[0]
    if len(poses.support) == 0:
        return torch.eye(4, dtype=torch.float64)
    R, t = poses.rotation[0], poses.translation[0]
    return rigid(R, t + target.origin[0] - apply_rotation(R, source.origin[0])).cpu()


def stream(place: int, number: int) -> int:
    """The seed of one of a place's streams of random numbers: 0 and 1 draw points, the others are runs of RANSAC."""
    return int(np.random.SeedSequence((place, number)).generate_state(1)[0])
