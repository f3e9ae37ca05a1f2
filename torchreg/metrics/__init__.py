"""Measures of a registration: errors of a transform, coverage of clouds, quality of matches, recall."""

from torchreg.metrics.fit import fitness, inlier_rmse, overlap
from torchreg.metrics.matches import (
    feature_match_recall,
    information_of_matches,
    inlier_ratio,
    rmse_by_information,
    rmse_of_true_matches,
)
from torchreg.metrics.pose import (
    PoseErrors,
    pose_errors,
    recalled_by_error,
    recalled_by_rmse,
    registration_recall,
    rmse,
    rre,
    rte,
)

__all__ = [
    "PoseErrors",
    "feature_match_recall",
    "fitness",
    "information_of_matches",
    "inlier_ratio",
    "inlier_rmse",
    "overlap",
    "pose_errors",
    "recalled_by_error",
    "recalled_by_rmse",
    "registration_recall",
    "rmse",
    "rmse_by_information",
    "rmse_of_true_matches",
    "rre",
    "rte",
]
