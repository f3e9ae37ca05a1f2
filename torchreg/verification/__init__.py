"""Which candidate pose is right, if any, judged on the clouds themselves and given with a probability."""

from torchreg.verification.pairs import (
    WORK,
    WORK_AGAIN,
    OverlapFeatures,
    PairLengths,
    ProposedPoses,
    WorkPerPair,
    proposals_of,
)

__all__ = ["WORK", "WORK_AGAIN", "OverlapFeatures", "PairLengths", "ProposedPoses", "WorkPerPair", "proposals_of"]
