"""Scan pairs and correspondence problems with known truth.

Example:
    >>> from torchreg.datasets import mall
    >>> mall(seed=3, angular_step=2.0).name
    'mall-3'
"""

from torchreg.datasets.mall import mall
from torchreg.datasets.matches import MatchProblem, match_problem
from torchreg.datasets.pair import ScanPair

__all__ = ["MatchProblem", "ScanPair", "mall", "match_problem"]
