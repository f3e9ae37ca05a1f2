"""Scan pairs with known truth.

Example:
    >>> from torchreg.datasets import mall
    >>> mall(seed=3, angular_step=2.0).name
    'mall-3'
"""

from torchreg.datasets.mall import mall
from torchreg.datasets.pair import ScanPair

__all__ = ["ScanPair", "mall"]
