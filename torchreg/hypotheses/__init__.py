"""What every solver shares: counts by one product, exact scores, refits, distinct poses, the loop, the verdict."""

from torchreg.hypotheses.collect import Judged, collect
from torchreg.hypotheses.found import Found, MatchedPoints, PairPoses
from torchreg.hypotheses.loop import one_per_pair, poses_of_pairs
from torchreg.hypotheses.proposals import Proposals, distinct_poses, proposal_dtype
from torchreg.hypotheses.refine import QUALITIES
from torchreg.hypotheses.seeds import base_seed, pair_seed

__all__ = [
    "QUALITIES",
    "Found",
    "Judged",
    "MatchedPoints",
    "PairPoses",
    "Proposals",
    "base_seed",
    "collect",
    "distinct_poses",
    "one_per_pair",
    "pair_seed",
    "poses_of_pairs",
    "proposal_dtype",
]
