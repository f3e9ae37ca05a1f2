"""Scores of a scene as the 3DMatch benchmark counts, and their mean over scenes.

Registration recall: share of the pairs of fragments that do not follow one another (j > i + 1) whose root mean square
error over the true matches, by ``gt.info``, is at most 0.2 m. Zeng et al., 3DMatch, CVPR 2017,
doi:10.1109/CVPR.2017.29, after Choi, Zhou and Koltun, CVPR 2015, doi:10.1109/CVPR.2015.7299195. Feature-match recall
and inlier ratio: of all pairs of the log, at 0.1 m and 5 %. Deng et al., PPFNet, CVPR 2018,
doi:10.1109/CVPR.2018.00028. What is averaged over scenes counts every scene alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from torchreg.benchmark.core.bootstrap import Interval, bootstrap
from torchreg.benchmark.core.rows import Row

RMSE = 0.2
"""Meters."""

NEAR = 0.1
"""Meters; a match whose points lie nearer to each other under the truth is an inlier."""

LEAST_INLIER_RATIO = 0.05
"""Above which feature-match recall counts a pair."""


class SceneScore(NamedTuple):
    """One method on one scene, or the mean over scenes. ``None`` where there are no such pairs."""

    recall: float | None  # registration recall
    match_recall: float | None  # feature-match recall
    inlier_ratio: float | None  # mean over the pairs
    rre_deg: float | None  # mean over the pairs recalled, degrees
    rte_m: float | None  # likewise, meters
    seconds: float | None  # mean over the pairs


def counts(row: Row) -> bool:
    """Whether registration recall counts the pair: its fragments do not follow one another."""
    return bool(row["j"] - row["i"] > 1)


def recalled(row: Row) -> bool:
    """Whether the error is small enough: by the information matrix, or by the points where there is none."""
    error = row["rmse_m"] if row["information_rmse_m"] is None else row["information_rmse_m"]
    return error is not None and bool(error <= RMSE)


def score(rows: Sequence[Row]) -> SceneScore:
    """The rows of one method on one scene."""
    counted = [row for row in rows if counts(row)]
    good = [row for row in counted if recalled(row)]
    ratios = [row["inlier_ratio"] for row in rows if row["inlier_ratio"] is not None]
    return SceneScore(
        recall=_mean(float(recalled(row)) for row in counted),
        match_recall=_mean(float(ratio > LEAST_INLIER_RATIO) for ratio in ratios),
        inlier_ratio=_mean(ratios),
        rre_deg=_mean(row["rre_deg"] for row in good),
        rte_m=_mean(row["rte_m"] for row in good),
        seconds=_mean(row["seconds"] for row in rows),
    )


def mean_score(scores: Sequence[SceneScore]) -> SceneScore:
    """The mean over scenes, of each number over those that have it."""
    return SceneScore(*(_mean(value for value in column if value is not None) for column in zip(*scores, strict=True)))


def pooled_recall(rows: Sequence[Row], seed: int = 0) -> Interval | None:
    """Registration recall over the pairs of all scenes alike, with its 95 % interval."""
    counted = [float(recalled(row)) for row in rows if counts(row)]
    return bootstrap(counted, seed=seed) if counted else None


def _mean(values: Iterable[float]) -> float | None:
    listed = list(values)
    return sum(listed) / len(listed) if listed else None
