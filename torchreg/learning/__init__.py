"""Training of what the paper fixes by hand: losses, augmentation, and weights learned on some scenes for others."""

from torchreg.learning.losses import (
    PoseLoss,
    circle_loss,
    info_nce,
    inlier_probability_loss,
    pose_loss,
    true_distances,
)
from torchreg.learning.sampling import Samples, draw_samples, score_function_loss
from torchreg.learning.soft_selection import (
    DrawnHypothesis,
    SoftSelection,
    draw_hypothesis,
    expected_loss,
    select_softly,
)

__all__ = [
    "DrawnHypothesis",
    "PoseLoss",
    "Samples",
    "SoftSelection",
    "circle_loss",
    "draw_hypothesis",
    "draw_samples",
    "expected_loss",
    "info_nce",
    "inlier_probability_loss",
    "pose_loss",
    "score_function_loss",
    "select_softly",
    "true_distances",
]
