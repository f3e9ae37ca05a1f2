"""What every solver shares: counts by one product, exact scores, refits, distinct poses, the loops, the verdict."""

from torchreg.solvers.collect import Judged, collect
from torchreg.solvers.found import Found, PairPoses
from torchreg.solvers.loop import one_per_pair, poses_of_pairs
from torchreg.solvers.points import MatchedPoints
from torchreg.solvers.proposals import Proposals, proposal_dtype
from torchreg.solvers.seeds import base_seed, pair_seed

__all__ = [
    "Found",
    "Judged",
    "MatchedPoints",
    "PairPoses",
    "Proposals",
    "base_seed",
    "collect",
    "one_per_pair",
    "pair_seed",
    "poses_of_pairs",
    "proposal_dtype",
]
