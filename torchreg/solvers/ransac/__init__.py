"""From correspondences to transforms by samples: draw, prune, solve, score, refine."""

from torchreg.solvers.ransac.loop import judged, ransac, ransac_poses

__all__ = ["judged", "ransac", "ransac_poses"]
