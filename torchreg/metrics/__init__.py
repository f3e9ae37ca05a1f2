"""How right a registration is: errors of a transform, coverage of clouds, quality of matches, recall."""

from torchreg.metrics.fit import fitness, inlier_rmse, overlap
from torchreg.metrics.matches import feature_match_recall, inlier_ratio
from torchreg.metrics.pose import PoseErrors, pose_errors, rmse, rre, rte
from torchreg.metrics.recall import recalled_by_error, recalled_by_rmse, registration_recall
from torchreg.metrics.true_matches import information_of_matches, rmse_by_information, rmse_of_true_matches

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
