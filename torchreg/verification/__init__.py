"""Which candidate pose is right, if any: asked of the clouds themselves, answered with a probability."""

from torchreg.verification.pairs import WORK, PairLengths, ProposedPoses, WorkPerPair, proposals_of

__all__ = ["WORK", "PairLengths", "ProposedPoses", "WorkPerPair", "proposals_of"]
