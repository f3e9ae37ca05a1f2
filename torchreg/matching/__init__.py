"""From features to correspondences: hard ones, and soft ones with gradients."""

from torchreg.matching.dual_softmax import dual_softmax
from torchreg.matching.mutual import match_mutual
from torchreg.matching.sinkhorn import sinkhorn
from torchreg.matching.soft import soft_match
from torchreg.matching.soft_targets import SoftTargets, soft_targets

__all__ = ["SoftTargets", "dual_softmax", "match_mutual", "sinkhorn", "soft_match", "soft_targets"]
