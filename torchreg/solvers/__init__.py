"""From matches to poses: the solvers, and the steps that they share. ``SOLVERS`` names each in one line."""

from torchreg.solvers.batch import poses_of_pairs
from torchreg.solvers.compatibility import CompatibilityOptions
from torchreg.solvers.points import MatchedPoints, base_seed
from torchreg.solvers.poses import PairPoses
from torchreg.solvers.ransac import RansacOptions
from torchreg.solvers.result import hypothesis_counts, result_of_poses, solve
from torchreg.solvers.solver import Hypotheses, Solver

SOLVERS: dict[str, type[Solver]] = {
    RansacOptions.name: RansacOptions,
    CompatibilityOptions.name: CompatibilityOptions,
}
"""The solvers of this package by name, in the order in which they are offered."""

__all__ = [
    "SOLVERS",
    "CompatibilityOptions",
    "Hypotheses",
    "MatchedPoints",
    "PairPoses",
    "RansacOptions",
    "Solver",
    "base_seed",
    "hypothesis_counts",
    "poses_of_pairs",
    "result_of_poses",
    "solve",
]
