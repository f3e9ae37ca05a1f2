"""Correspondences in feature space: exact mutual nearest neighbors, and soft matches to train through."""

from torchreg.matching.mutual import match_mutual
from torchreg.matching.soft import soft_match

__all__ = ["match_mutual", "soft_match"]
