"""When a pair counts as found, and the figures of a method over a group of pairs, with intervals.

All bounds follow the voxels v that a pair's clouds are averaged over, so that rooms and facades are judged alike; at
5 cm they are the numbers of 3DMatch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from torchreg.benchmark.core.bootstrap import Interval, bootstrap, mean, median
from torchreg.benchmark.core.rows import Row

ROTATION = 15.0
"""Degrees."""

TRANSLATION_VOXELS = 6.0
"""0.3 m at 5 cm, as Choy et al., Deep Global Registration, CVPR 2020, doi:10.1109/CVPR42600.2020.00259."""

RMSE_VOXELS = 4.0
"""0.2 m at 5 cm, as Choi et al., CVPR 2015, doi:10.1109/CVPR.2015.7299195, and 3DMatch after them."""

MATCH_VOXELS = 2.0
"""A match is an inlier, and a source point overlaps, where the truth brings it nearer: 0.1 m at 5 cm, as PPFNet."""

LEAST_INLIER_RATIO = 0.05
"""Above which feature-match recall counts a pair; Deng et al., PPFNet, CVPR 2018, doi:10.1109/CVPR.2018.00028."""

Group = tuple[str, Callable[[Row], bool]]
"""A name, and which rows belong."""

OVERLAPS: tuple[tuple[str, float, float], ...] = (
    ("overlap 0.6 and more", 0.6, 2.0),
    ("overlap 0.35 to 0.6", 0.35, 0.6),
    ("overlap below 0.35", -1.0, 0.35),
)


class FieldCell(NamedTuple):
    """One method on one group of pairs. Rates are shares of pairs; ``None`` where there are none."""

    pairs: int
    recall: Interval  # by rotation and translation error
    recall_rmse: Interval  # by the root mean square error over the true matches
    match_recall: Interval | None  # share of pairs whose matches suffice
    inlier_ratio: Interval | None  # mean over the pairs
    rre_deg: Interval | None  # median over the pairs found by errors, degrees
    rte_m: Interval | None  # likewise, meters
    seconds: Interval  # median
    wrong_called_right: int  # pairs not found by errors that the method calls a success
    right_refused: int  # pairs found that it does not call a success
    errors: int  # pairs on which it ended with an exception


def found_by_errors(row: Row) -> bool:
    """Rotation and translation errors both below their bounds."""
    return bool(row["rre_deg"] < ROTATION and row["rte_m"] < TRANSLATION_VOXELS * row["voxel_m"])


def found_by_rmse(row: Row) -> bool:
    """The root mean square error over the true matches below its bound."""
    return row["rmse_m"] is not None and bool(row["rmse_m"] < RMSE_VOXELS * row["voxel_m"])


def enough_inliers(row: Row) -> bool | None:
    """Whether the inlier ratio suffices; ``None`` where the method does not return its matches."""
    return None if row["inlier_ratio"] is None else bool(row["inlier_ratio"] > LEAST_INLIER_RATIO)


def groups(rows: Sequence[Row]) -> list[Group]:
    """All pairs, then those of every scene, then those of every range of overlap that has some."""
    parts: list[Group] = [("all pairs", lambda _: True)]
    parts += [(scene, _of_scene(scene)) for scene in dict.fromkeys(row["scene"] for row in rows)]
    for name, low, high in OVERLAPS:
        belongs = _of_overlap(low, high)
        if any(map(belongs, rows)):
            parts.append((name, belongs))
    return parts


def summarize(rows: Sequence[Row], seed: int = 0) -> FieldCell:
    """One cell of some rows of one method, at least one."""
    found = [row for row in rows if found_by_errors(row)]
    lost = [row for row in rows if not found_by_errors(row)]
    return FieldCell(
        pairs=len(rows),
        recall=bootstrap([float(found_by_errors(row)) for row in rows], seed=seed),
        recall_rmse=bootstrap([float(found_by_rmse(row)) for row in rows], seed=seed),
        match_recall=_known((enough_inliers(row) for row in rows), mean, seed),
        inlier_ratio=_known((row["inlier_ratio"] for row in rows), mean, seed),
        rre_deg=_known((row["rre_deg"] for row in found), median, seed),
        rte_m=_known((row["rte_m"] for row in found), median, seed),
        seconds=bootstrap([row["seconds"] for row in rows], median, seed=seed),
        wrong_called_right=sum(row["success"] for row in lost),
        right_refused=sum(not row["success"] for row in found),
        errors=sum(bool(row["error"]) for row in rows),
    )


def difference(rows: Sequence[Row], base: Sequence[Row], seed: int = 0) -> Interval | None:
    """How much the recall by errors of one method is above another's, over the pairs that both ran on."""
    other = {row["pair"]: found_by_errors(row) for row in base}
    both = [float(found_by_errors(row)) - other[row["pair"]] for row in rows if row["pair"] in other]
    return bootstrap(both, seed=seed) if both else None


def _of_scene(scene: str) -> Callable[[Row], bool]:
    return lambda row: bool(row["scene"] == scene)


def _of_overlap(low: float, high: float) -> Callable[[Row], bool]:
    return lambda row: bool(low <= row["overlap"] < high)


def _known(values: Iterable[float | None], statistic: Callable[[Any], Any], seed: int) -> Interval | None:
    known = [float(value) for value in values if value is not None]
    return bootstrap(known, statistic, seed=seed) if known else None
