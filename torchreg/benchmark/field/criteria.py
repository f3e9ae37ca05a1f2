"""When a pair of the real scans counts as found.

All bounds follow the voxels v that a pair's clouds are averaged over, so that rooms and facades are judged alike; at
5 cm they are the numbers of 3DMatch.
"""

from __future__ import annotations

from typing import Any

ROTATION = 15.0
"""Degrees."""

TRANSLATION_VOXELS = 6.0
"""0.3 m at 5 cm, as Choy et al., Deep Global Registration, CVPR 2020, doi:10.1109/CVPR42600.2020.00259."""

RMSE_VOXELS = 4.0
"""0.2 m at 5 cm, as Choi et al., CVPR 2015, doi:10.1109/CVPR.2015.7299195, and 3DMatch after them."""

MATCH_VOXELS = 2.0
"""A match is an inlier, and a source point overlaps, where the truth brings it nearer: 0.1 m at 5 cm, as PPFNet."""

MATCHED = 0.05
"""The inlier ratio that feature-match recall asks for; Deng et al., PPFNet, CVPR 2018, doi:10.1109/CVPR.2018.00028."""


def found_by_errors(row: dict[str, Any]) -> bool:
    """Rotation and translation errors both below their bounds."""
    return bool(row["rre_deg"] < ROTATION and row["rte_m"] < TRANSLATION_VOXELS * row["voxel_m"])


def found_by_rmse(row: dict[str, Any]) -> bool:
    """The root mean square error over the true matches below its bound."""
    return row["rmse_m"] is not None and bool(row["rmse_m"] < RMSE_VOXELS * row["voxel_m"])


def matched(row: dict[str, Any]) -> bool | None:
    """Whether the inlier ratio suffices; ``None`` where the method does not tell its matches."""
    return None if row["inlier_ratio"] is None else bool(row["inlier_ratio"] > MATCHED)
