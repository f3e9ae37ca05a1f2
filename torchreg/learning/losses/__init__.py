"""What training makes small: errors of poses, of correspondences between features, of inlier probabilities."""

from torchreg.learning.losses.circle import circle_loss, true_distances
from torchreg.learning.losses.contrastive import info_nce
from torchreg.learning.losses.inliers import inlier_probability_loss
from torchreg.learning.losses.pose import PoseLoss, pose_loss

__all__ = ["PoseLoss", "circle_loss", "info_nce", "inlier_probability_loss", "pose_loss", "true_distances"]
