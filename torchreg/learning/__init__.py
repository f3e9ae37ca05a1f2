"""Training of what the paper sets by hand: losses, differentiable hypotheses, the color block's weights, a network."""

from torchreg.learning.correspondence_losses import circle_loss, info_nce, inlier_probability_loss, true_distances
from torchreg.learning.held_out import GroupQuality, MatchQuality, baselines, by_group, match_quality, network_features
from torchreg.learning.network_training import NetworkTraining, NetworkTrainingOptions, load_network
from torchreg.learning.pose_losses import PoseLoss, pose_loss
from torchreg.learning.posed_pairs import PosedPair
from torchreg.learning.prepared import PreparedCloud, PreparedPair, prepare_cloud, prepare_pair
from torchreg.learning.sampling import Samples, draw_samples, score_function_loss
from torchreg.learning.soft_selection import (
    DrawnHypothesis,
    SoftSelection,
    draw_hypothesis,
    expected_loss,
    select_softly,
)
from torchreg.learning.training import TrainingOptions, describe_with, train_color

__all__ = [
    "DrawnHypothesis",
    "GroupQuality",
    "MatchQuality",
    "NetworkTraining",
    "NetworkTrainingOptions",
    "PoseLoss",
    "PosedPair",
    "PreparedCloud",
    "PreparedPair",
    "Samples",
    "SoftSelection",
    "TrainingOptions",
    "baselines",
    "by_group",
    "circle_loss",
    "describe_with",
    "draw_hypothesis",
    "draw_samples",
    "expected_loss",
    "info_nce",
    "inlier_probability_loss",
    "load_network",
    "match_quality",
    "network_features",
    "pose_loss",
    "prepare_cloud",
    "prepare_pair",
    "score_function_loss",
    "select_softly",
    "train_color",
    "true_distances",
]
