"""From correspondences to transforms by their agreement with one another: no sample is drawn."""

from torchreg.solvers.compatibility.solver import CompatibilityOptions, compatibility

__all__ = ["CompatibilityOptions", "compatibility"]
