"""Scan pairs and correspondence problems with known truth: simulated, or from files for a ``DataLoader``.

Example:
    >>> from torchreg.datasets import mall
    >>> mall(seed=3, angular_step=2.0).name
    'mall-3'
"""

from torchreg.datasets.cloud_files import CloudFiles, CloudReader
from torchreg.datasets.fragments import Fragments
from torchreg.datasets.scan_pairs import ScanPairs
from torchreg.synthetic.mall_scans import mall
from torchreg.synthetic.match_problems import MatchProblem, match_problem
from torchreg.synthetic.road_scans import road
from torchreg.types.scan_pair import ScanPair
from torchreg.types.scan_pair_batch import ScanPairBatch, pack_pairs

__all__ = [
    "CloudFiles",
    "CloudReader",
    "Fragments",
    "MatchProblem",
    "ScanPair",
    "ScanPairBatch",
    "ScanPairs",
    "mall",
    "match_problem",
    "pack_pairs",
    "road",
]
