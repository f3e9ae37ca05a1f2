"""Iterative closest point: from a transform that is about right to one that is as good as the clouds."""

from torchreg.refinement.icp import refine_pairs
from torchreg.refinement.options import IcpLevel, IcpOptions
from torchreg.refinement.pairing import Pairing
from torchreg.refinement.result import IcpResult

__all__ = ["IcpLevel", "IcpOptions", "IcpResult", "Pairing", "refine_pairs"]
