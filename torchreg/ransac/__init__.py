"""From correspondences to transforms: draw, prune, solve, score, refine."""

from torchreg.ransac.loop import ransac

__all__ = ["ransac"]
