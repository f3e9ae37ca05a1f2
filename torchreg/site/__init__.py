"""A site: many scans in one frame, from the links between pairs of them."""

from torchreg.site.control import ControlPoint
from torchreg.site.frame import SiteFrame
from torchreg.site.links import KnownPose, Link, loose_covariance
from torchreg.site.pairs import SiteProgress
from torchreg.site.placement import Placement, place
from torchreg.site.result import SiteLink, SiteResult, TriedPair
from torchreg.site.tolerance import Tolerance

__all__ = [
    "ControlPoint",
    "KnownPose",
    "Link",
    "Placement",
    "SiteFrame",
    "SiteLink",
    "SiteProgress",
    "SiteResult",
    "Tolerance",
    "TriedPair",
    "loose_covariance",
    "place",
]
