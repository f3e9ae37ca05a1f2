"""A site: many scans in one frame, from the links between pairs of them."""

from torchreg.site.links import KnownPose, Link, loose_covariance
from torchreg.site.placement import Placement, place
from torchreg.site.tolerance import Tolerance

__all__ = ["KnownPose", "Link", "Placement", "Tolerance", "loose_covariance", "place"]
