"""What every solver shares: counts by one product, exact scores, refits, distinct poses, the loops, the verdict."""

from torchreg.hypotheses.collect import Judged, collect
from torchreg.hypotheses.found import Found, PairPoses
from torchreg.hypotheses.loop import one_per_pair, poses_of_pairs
from torchreg.hypotheses.points import MatchedPoints
from torchreg.hypotheses.proposals import Proposals, proposal_dtype
from torchreg.hypotheses.seeds import base_seed, pair_seed

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
