"""Simulated data of known truth: pairs of scans of a mall or a road, and correspondences without scans.

Example:
    >>> mall(seed=3, angular_step=2.0).name
    'mall-3'
"""

from torchreg.synthetic.mall_scans import mall
from torchreg.synthetic.match_problems import MatchProblem, match_problem
from torchreg.synthetic.road_scans import road

__all__ = ["MatchProblem", "mall", "match_problem", "road"]
