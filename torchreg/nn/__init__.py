"""Modules over the functions: they hold options and learnable weights, and nothing else."""

from torchreg.nn.descriptors import FPFH, PCFH, BinEdges
from torchreg.nn.equalize import Equalize, PairValues
from torchreg.nn.matching import Fuse, SoftMatch, WeightedKabsch
from torchreg.nn.network_block import NetworkBlock
from torchreg.nn.point_network import PointNetwork
from torchreg.nn.register import Register, SoftRegistration

__all__ = [
    "FPFH",
    "PCFH",
    "BinEdges",
    "Equalize",
    "Fuse",
    "NetworkBlock",
    "PairValues",
    "PointNetwork",
    "Register",
    "SoftMatch",
    "SoftRegistration",
    "WeightedKabsch",
]
