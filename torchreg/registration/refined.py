"""The last stage: the poses of pairs that succeed, refined on surfels of both clouds, and the result with them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import lane_sums
from torchreg.geometry.se3 import apply_rotation
from torchreg.metrics.fit import relative_transform
from torchreg.neighborhoods.coverage import Coverage, coverage
from torchreg.refinement.refine import Refined, refine_on_surfels, residuals_under
from torchreg.refinement.surfels import Surfels
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.stopwatch import stage
from torchreg.types import Clouds, RegistrationResult
from torchreg.types.packing import spans

_LEAST_KEPT = 0.95  # of how well the thinned clouds cover each other
_WORSE = "the thinned clouds would cover each other less"

Notes = tuple[tuple[str, ...], ...]
"""Of every pair."""


class _Fit(NamedTuple):
    """One pair under its refined pose, measured as the result has it."""

    near: Coverage
    inliers: Tensor  # (M,) bool, of its matches


def refined(
    source: DescribedClouds,
    target: DescribedClouds,
    result: RegistrationResult,
    options: Sequence[RegistrationOptions],
) -> tuple[RegistrationResult, Notes]:
    """The result with refined poses, and a note for every pair whose pose stays as it was found.

    ``fitness``, ``inlier_rmse`` and ``inliers`` follow the poses; what was weighed before stays.
    """
    if source.surfels is None or target.surfels is None:
        return result, ((),) * len(result)
    return _refined(source.surfels, target.surfels, result, options)


@stage("refinement")
def _refined(
    source: Surfels, target: Surfels, result: RegistrationResult, options: Sequence[RegistrationOptions]
) -> tuple[RegistrationResult, Notes]:
    thresholds = [option.inlier_threshold for option in options]
    failed = [failure is not None for failure in result.failure]
    sizes = [size_of(cloud) for cloud in result.source.unpack()]
    done = refine_on_surfels(source, target, result.T_target_source, thresholds, failed, sizes)
    fitness, rmse, inliers = result.fitness.clone(), result.inlier_rmse.clone(), result.inliers.clone()
    rows, reasons, kept = spans(result.correspondences.offsets), list(done.reason), [False] * len(result)
    for b, (one, other) in enumerate(zip(result.source.unpack(), result.target.unpack(), strict=True)):
        if failed[b] or reasons[b]:
            continue
        fit = _fit(one, other, result, b, done.T_target_source[b], thresholds[b])
        before = _cover(Coverage(fitness[b], rmse[b]), thresholds[b])
        if bool(_cover(fit.near, thresholds[b]) < _LEAST_KEPT * before):
            reasons[b] = _WORSE
            continue
        kept[b] = True
        fitness[b], rmse[b] = fit.near
        inliers[slice(*rows[b])] = fit.inliers
    changed = replace(
        result,
        fitness=fitness,
        inlier_rmse=rmse,
        inliers=inliers,
        **_figures(done, torch.tensor(kept, device=fitness.device), result.T_target_source),
    )
    return changed, tuple((f"the pose is not refined: {reason}",) if reason else () for reason in reasons)


def size_of(cloud: Clouds) -> float:
    """The root mean square distance of the points of one cloud from their mean, meters; 0 without points."""
    if len(cloud.points) == 0:
        return 0.0
    wide = cloud.points.double()
    apart = (wide - lane_sums(wide, dim=0) / len(wide)).square()
    return math.sqrt(float(lane_sums(apart, dim=0).sum()) / len(wide))


def given_residuals(
    source: DescribedClouds, target: DescribedClouds, T: Tensor | None, refused: Sequence[object]
) -> Tensor:
    """Residuals (B, 3), meters, under given transforms (B, 4, 4); NaN without transforms or surfels."""
    if T is None or source.surfels is None or target.surfels is None:
        return torch.full((len(source), 3), torch.nan, dtype=torch.float64, device=source.cloud.device)
    return residuals_under(source.surfels, target.surfels, T, [bool(each) for each in refused])


def _figures(done: Refined, kept: Tensor, before: Tensor) -> dict[str, Any]:
    """The fields of the result that refinement fills, of the pairs (B,) that keep it."""
    median, rms, most = done.residuals.unbind(dim=1)
    figures = {
        "residual_median": median,
        "residual_rms": rms,
        "residual_95": most,
        "covariance": done.covariance,
        "center": done.center,
        "axis_strength": done.held,
    }
    places = {name: kept.view(-1, *[1] * (value.ndim - 1)) for name, value in figures.items()}
    shown = {name: torch.where(places[name], value, torch.nan) for name, value in figures.items()}
    return {"T_target_source": torch.where(kept[:, None, None], done.T_target_source, before), **shown}


def _cover(near: Coverage, threshold: float) -> Tensor:
    """The mean over all source points of 1 - (distance / threshold)^2, 0 for those without a partner."""
    return near.fitness * (1 - (near.inlier_rmse / threshold).square())


def _fit(source: Clouds, target: Clouds, result: RegistrationResult, b: int, T: Tensor, threshold: float) -> _Fit:
    """Of pair ``b``, whose thinned clouds are ``source`` and ``target``, under a transform (4, 4)."""
    R, t = (part[0] for part in relative_transform(source, target, T[None]))
    rows = slice(*spans(result.correspondences.offsets)[b])
    one = result.source.points[result.correspondences.source[rows]].double()
    other = result.target.points[result.correspondences.target[rows]].double()
    apart = apply_rotation(R, one) + t - other
    inside = apart.square().sum(dim=1) < threshold**2
    return _Fit(coverage(source.points, target.points, R, t, threshold), inside)
