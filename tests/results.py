"""Results made by hand: with every field that weighing poses on the clouds fills, and without."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch
from problems import matched, turned
from torch import Tensor

import torchreg as tr
from torchreg.types import Candidate, Failure, Proposal, StageCounts

OPTIONS = tr.RegistrationOptions(
    voxel_size=0.05,
    normal_radius=0.1,
    feature_radius=0.25,
    color=("contrast", "pcfh"),
    color_weights=(0.8, 0.5),
    match_neighbors=2,
    ransac=tr.RansacOptions(inlier_threshold=0.075),
    effort="balanced",
)
PROPOSALS = (
    Proposal("fpfh + contrast, compatibility", 2104, 512, 400, 200, 12, 310),
    Proposal("fpfh, compatibility", 1800, 512, 300, 100, 1, 90),
)
FOUR_POINTS = tr.Clouds(torch.eye(4)[:, :3], colors=torch.eye(4)[:, :3], viewpoint=torch.zeros(1, 3))
STAGES = StageCounts((30433, 28001), (9812, 9950), (9700, 9950), PROPOSALS)


def candidate(**changes: Any) -> Candidate:
    """One pose that was weighed, good unless changed."""
    good = Candidate(
        origin=PROPOSALS[0].origin,
        T_target_source=turned(10),
        support=310,
        matches=2104,
        surprise=41.7,
        overlap=0.52,
        closeness=0.6,
        normals=0.91,
        colors=0.43,
        strength=0.31,
        conflict=0.012,
        misses=0.21,
        features=0.63,
        color_features=0.58,
        log_odds=6.3,
        probability=0.998,
    )
    return good._replace(**changes)


def bare_result(**changes: Any) -> tr.RegistrationResult:
    """One pair as a solver alone leaves it: 4 matches, 3 of them inliers."""
    one = torch.tensor([1], dtype=torch.int64)
    fields: dict[str, Any] = {
        "T_target_source": turned(10)[None],
        "inliers": torch.tensor([True, True, True, False]),
        "fitness": number(0.61),
        "inlier_rmse": number(0.0123),
        "success": torch.tensor([True]),
        "failure": (None,),
        "hypotheses": tr.HypothesisCounts(9000 * one, 800 * one, 70 * one),
        "source": FOUR_POINTS,
        "target": FOUR_POINTS,
        "correspondences": matched(torch.arange(4), torch.arange(4)),
    }
    return tr.RegistrationResult(**(fields | changes))


def verified_result(**changes: Any) -> tr.RegistrationResult:
    """One pair with every field that ``register`` fills; a right one unless changed."""
    probe = candidate(origin="slide", support=0, matches=0, surprise=math.nan, colors=math.nan)
    information = torch.eye(6, dtype=torch.float64)[None] * 100
    fields: dict[str, Any] = {
        "options": (OPTIONS,),
        "notes": (("downsampled to voxels of 0.05 m",),),
        "seconds": (("descriptors", 0.5), ("verification", 0.25)),
        "probability": number(0.998),
        "overlap": number(0.52),
        "information": information,
        "strength": number(0.31),
        "runner_up": turned(100, translation=(3.0, 4.0, 0.0))[None],
        "margin": number(5.2),
        "candidates": ((candidate(), probe),),
        "stages": (STAGES,),
    }
    return replace(bare_result(), **(fields | changes))


def failed_result(kind: str, text: str = "", **changes: Any) -> tr.RegistrationResult:
    """As ``verified_result``, refused for a reason of this kind."""
    fields: dict[str, Any] = {
        "T_target_source": torch.eye(4, dtype=torch.float64)[None],
        "success": torch.tensor([False]),
        "failure": (Failure(kind, text or kind),),
        "probability": number(0.07),
    }
    return verified_result(**(fields | changes))


def number(value: float) -> Tensor:
    """(1,) float64."""
    return torch.tensor([value], dtype=torch.float64)


def verification(**changes: Any) -> tr.Verification:
    """The verdict on one given transform 0.1 m from the pose that wins; right unless changed."""
    search = verified_result()
    given = candidate(origin="given", T_target_source=turned(10, translation=(0.1, 0.0, 0.0)), overlap=0.47)
    fields: dict[str, Any] = {
        "T_target_source": given.T_target_source[None],
        "success": torch.tensor([True]),
        "failure": (None,),
        "probability": number(0.998),
        "settled": search.T_target_source,
        "deviation_meters": number(0.1),
        "deviation_degrees": number(0.25),
        "likeliest": search.T_target_source,
        "fitness": number(0.55),
        "inlier_rmse": number(0.02),
        "overlap": number(0.47),
        "residual_median": number(0.031),
        "residual_rms": number(0.042),
        "residual_95": number(0.087),
        "candidate": (given,),
        "settled_candidate": search.candidates[0][:1],
        "rival": (candidate(origin="slide", T_target_source=turned(100), probability=0.001),),
        "search": search,
    }
    return tr.Verification(**(fields | changes))
