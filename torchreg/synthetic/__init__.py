"""Simulated scans of known truth: a mall, a road, and matches without clouds."""

from torchreg.synthetic.mall_scans import mall
from torchreg.synthetic.match_problems import MatchProblem, match_problem
from torchreg.synthetic.road_scans import road

__all__ = ["MatchProblem", "mall", "match_problem", "road"]
