"""Modules over the functions: they hold options and learnable weights, and nothing else."""

from torchreg.nn.bin_edges import BinEdges
from torchreg.nn.descriptors import FPFH, PCFH
from torchreg.nn.equalize import Equalize, PairValues
from torchreg.nn.fuse import Fuse
from torchreg.nn.register import Register, SoftRegistration
from torchreg.nn.soft_match import SoftMatch
from torchreg.nn.weighted_kabsch import WeightedKabsch

__all__ = [
    "FPFH",
    "PCFH",
    "BinEdges",
    "Equalize",
    "Fuse",
    "PairValues",
    "Register",
    "SoftMatch",
    "SoftRegistration",
    "WeightedKabsch",
]
