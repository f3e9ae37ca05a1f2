"""What counts as recalled: the protocol of 3DMatch and Color3DMatch, in meters or by the voxels of a pair.

Registration recall: share of the pairs whose root mean square error over the source points that overlap under the truth
is below 0.2 m. Choi, Zhou and Koltun, CVPR 2015, doi:10.1109/CVPR.2015.7299195; Mu et al., ColorPCR, CVPR 2024, for
Color3DMatch. Inlier ratio: share of the matches nearer than 0.1 m under the truth; feature-match recall: share of the
pairs where it is above 5 %. Deng et al., PPFNet, CVPR 2018, doi:10.1109/CVPR.2018.00028. By voxels v the bounds are 4 v
and 2 v, which at 5 cm are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from torchreg.benchmark.core.bootstrap import Interval, bootstrap, mean, median
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.field.summary import LEAST_INLIER_RATIO, MATCH_VOXELS, RMSE_VOXELS
from torchreg.benchmark.threedmatch.protocol import NEAR, RMSE


class Protocol(NamedTuple):
    """Bounds, in meters or in voxels."""

    in_meters: bool

    def near(self, voxel: float) -> float:
        """Meters; nearer to its partner under the truth, a match is an inlier and a source point overlaps."""
        return NEAR if self.in_meters else MATCH_VOXELS * voxel

    def recalled(self, row: Row) -> bool:
        """Whether the error of a pair is below the bound."""
        bound = RMSE if self.in_meters else RMSE_VOXELS * row["voxel_m"]
        return row["rmse_m"] is not None and bool(row["rmse_m"] < bound)

    @property
    def words(self) -> tuple[str, str]:
        """The bounds of errors and of matches."""
        if self.in_meters:
            return f"{RMSE:g} m", f"{NEAR:g} m"
        return f"{RMSE_VOXELS:g} v", f"{MATCH_VOXELS:g} v"


class FeatureScore(NamedTuple):
    """One method on a group of pairs; ``None`` where it returns no matches."""

    pairs: int
    recall: Interval  # registration recall
    match_recall: Interval | None  # feature-match recall
    inlier_ratio: Interval | None  # mean over the pairs
    matches: float | None  # median over the pairs
    seconds: float  # median
    successes: int  # pairs that it calls a success
    wrong_called_right: int  # of those, not recalled
    right_refused: int  # recalled, and not called a success
    errors: int  # pairs on which it ended with an exception


def score(rows: Sequence[Row], protocol: Protocol, seed: int = 0) -> FeatureScore:
    """The rows of one method, at least one."""
    good = [protocol.recalled(row) for row in rows]
    ratios = [row["inlier_ratio"] for row in rows if row["inlier_ratio"] is not None]
    counts = [float(row["matches"]) for row in rows if row["matches"] is not None]
    enough = [float(ratio > LEAST_INLIER_RATIO) for ratio in ratios]
    called = [row["success"] for row in rows]
    return FeatureScore(
        pairs=len(rows),
        recall=bootstrap([float(one) for one in good], seed=seed),
        match_recall=bootstrap(enough, seed=seed) if enough else None,
        inlier_ratio=bootstrap(ratios, mean, seed=seed) if ratios else None,
        matches=bootstrap(counts, median, seed=seed).value if counts else None,
        seconds=bootstrap([row["seconds"] for row in rows], median, seed=seed).value,
        successes=sum(called),
        wrong_called_right=sum(said and not right for said, right in zip(called, good, strict=True)),
        right_refused=sum(right and not said for said, right in zip(called, good, strict=True)),
        errors=sum(bool(row["error"]) for row in rows),
    )
