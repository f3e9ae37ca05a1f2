"""Simulated data of known truth: pairs of scans of a mall or a road, scans of a building, correspondences alone.

Example:
    >>> mall(seed=3, angular_step=2.0).name
    'mall-3'
"""

from torchreg.synthetic.building_scans import building
from torchreg.synthetic.mall_scans import mall
from torchreg.synthetic.match_problems import MatchProblem, match_problem
from torchreg.synthetic.road_scans import road
from torchreg.types.simulated_site import SimulatedSite

__all__ = ["MatchProblem", "SimulatedSite", "building", "mall", "match_problem", "road"]
