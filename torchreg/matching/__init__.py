"""Correspondences in feature space: exact mutual nearest neighbors, and soft matches to train through."""

from torchreg.matching.mutual import match_mutual
from torchreg.matching.soft import SoftTargets, soft_match, soft_targets
from torchreg.matching.softmax import dual_softmax
from torchreg.matching.transport import sinkhorn

__all__ = ["SoftTargets", "dual_softmax", "match_mutual", "sinkhorn", "soft_match", "soft_targets"]
