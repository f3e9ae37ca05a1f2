"""How closely candidates are looked at, and in which lengths."""

from __future__ import annotations

from typing import NamedTuple

from torchreg.verification.reasons import ACCEPTED


class Care(NamedTuple):
    """How closely candidates are looked at.

    Attributes:
        poses: of every proposal, at most.
        sample: points of each scan that are looked at.
        refined: distinct candidates that ICP refines.
        iterations: of ICP at most.
        accepted: the least probability of a success.
    """

    poses: int
    sample: int
    refined: int
    iterations: int
    accepted: float = ACCEPTED


class Lengths(NamedTuple):
    """Meters, of one pair: an inlier's ``threshold`` and the ``spacing`` of the points."""

    threshold: float
    spacing: float
