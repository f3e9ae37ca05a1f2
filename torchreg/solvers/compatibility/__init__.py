"""From correspondences to transforms by their agreement with one another: no sample is drawn."""

from torchreg.solvers.compatibility.loop import compatibility, compatibility_poses, judged

__all__ = ["compatibility", "compatibility_poses", "judged"]
