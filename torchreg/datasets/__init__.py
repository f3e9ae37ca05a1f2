"""Pairs of scans from files for a ``DataLoader``; also the simulated ones of ``torchreg.synthetic``.

Example:
    >>> from torchreg.datasets import mall
    >>> mall(seed=3, angular_step=2.0).name
    'mall-3'
"""

from torchreg.datasets.cloud_files import CloudFiles, CloudReader
from torchreg.datasets.fragments import Fragments
from torchreg.datasets.scan_pairs import ScanPairs
from torchreg.datasets.training_places import simulated_pairs
from torchreg.synthetic import MatchProblem, SimulatedSite, building, mall, match_problem, road
from torchreg.types.scan_pair import ScanPair, ScanPairBatch, pack_pairs

__all__ = [
    "CloudFiles",
    "CloudReader",
    "Fragments",
    "MatchProblem",
    "ScanPair",
    "ScanPairBatch",
    "ScanPairs",
    "SimulatedSite",
    "building",
    "mall",
    "match_problem",
    "pack_pairs",
    "road",
    "simulated_pairs",
]
