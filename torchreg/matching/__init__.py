"""From features to correspondences."""

from torchreg.matching.mutual import match_mutual

__all__ = ["match_mutual"]
