"""When a pair counts as found, the figures of a fusion over a group of pairs, and its differences from another's."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from torchreg.benchmark.core.bootstrap import Interval, bootstrap_of_groups
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.field.summary import LEAST_INLIER_RATIO, ROTATION, TRANSLATION_VOXELS
from torchreg.benchmark.site.judge import DEGREES


class FamilyScore(NamedTuple):
    """One fusion on a group of pairs, at least one. Shares are of all pairs; ``None`` where nothing was measured."""

    pairs: int
    dimensions: int | None  # of a feature, the most of any pair: without colors there are fewer
    inlier_ratio: float  # mean
    match_recall: float  # share of the pairs with enough inliers
    plain_recall: float  # share found by matches alone
    recall: float  # share found by ``register``
    close_recall: float  # share of which the rotation is within 5 degrees
    wrong: int  # pairs not found that are called a success
    refused: int  # pairs found that are not
    describe_s: float | None  # median processor seconds until both clouds are described
    match_s: float | None  # median, of mutual matches and their pose
    seconds: float | None  # median, from the thinned clouds to the pose
    megabytes: float | None  # median, of the features of both clouds
    brier: float | None  # mean square of probability less the truth, 0 or 1
    probability_right: float | None  # mean probability of pairs found
    probability_wrong: float | None  # of pairs not found
    errors: int  # pairs that ended with an exception


def found(row: Row, prefix: str = "", rotation: float = ROTATION) -> bool:
    """Whether rotation and translation are off by less than their bounds, degrees and voxels of the list.

    By default those of ``torchreg bench field``, which the stated probability is calibrated to.
    """
    turn, shift = row[f"{prefix}rre_deg"], row[f"{prefix}rte_m"]
    return turn is not None and bool(turn < rotation and shift < TRANSLATION_VOXELS * row["voxel_m"])


def found_plain(row: Row) -> bool:
    """Whether the pose that most matches agree on is right."""
    return found(row, "plain_")


def found_closely(row: Row) -> bool:
    """Whether the rotation is off by less than 5 degrees at that."""
    return found(row, rotation=DEGREES)


def score(rows: Sequence[Row]) -> FamilyScore:
    """The rows of one fusion, at least one."""
    right = [row for row in rows if found(row)]
    wrong = [row for row in rows if not found(row)]
    judged = [row for row in rows if row["probability"] is not None]
    sizes = [row["dimensions"] for row in rows if row["dimensions"] is not None]
    size = _median(row["bytes"] for row in rows)
    return FamilyScore(
        pairs=len(rows),
        dimensions=max(sizes, default=None),
        inlier_ratio=statistics.fmean(row["inlier_ratio"] for row in rows),
        match_recall=statistics.fmean(row["inlier_ratio"] > LEAST_INLIER_RATIO for row in rows),
        plain_recall=statistics.fmean(map(found_plain, rows)),
        recall=len(right) / len(rows),
        close_recall=statistics.fmean(map(found_closely, rows)),
        wrong=sum(row["success"] for row in wrong),
        refused=sum(not row["success"] for row in right),
        describe_s=_median(row["describe_s"] for row in rows),
        match_s=_median(row["match_s"] for row in rows),
        seconds=_median(row["seconds"] for row in rows),
        megabytes=None if size is None else size / 1e6,
        brier=_mean((row["probability"] - found(row)) ** 2 for row in judged),
        probability_right=_mean(row["probability"] for row in judged if found(row)),
        probability_wrong=_mean(row["probability"] for row in judged if not found(row)),
        errors=sum(bool(row["error"]) for row in rows),
    )


Figure = Callable[[Row], float]
"""A number of one row."""

FIGURES: dict[str, Figure] = {
    "inliers": lambda row: row["inlier_ratio"],
    "plain": found_plain,
    "recall": found,
    "close": found_closely,
}
"""What is compared pair by pair."""


def difference(rows: Sequence[Row], base: Sequence[Row], figure: Figure, seed: int = 0) -> Interval | None:
    """How much a figure of one fusion is above another's, over the pairs of both, whole scenes drawn again.

    ``None`` where there are no such pairs.
    """
    other = {(row["list"], row["pair"]): figure(row) for row in base}
    both = [row for row in rows if (row["list"], row["pair"]) in other]
    if not both:
        return None
    values = [float(figure(row)) - other[row["list"], row["pair"]] for row in both]
    return bootstrap_of_groups(values, [(row["list"], row["scene"]) for row in both], seed=seed)


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.median(known) if known else None


def _mean(values: Iterable[float]) -> float | None:
    known = list(values)
    return statistics.fmean(known) if known else None
