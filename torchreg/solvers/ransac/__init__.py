"""From correspondences to transforms by samples: draw, prune, solve, score, refine."""

from torchreg.solvers.ransac.solver import RansacOptions, ransac

__all__ = ["RansacOptions", "ransac"]
