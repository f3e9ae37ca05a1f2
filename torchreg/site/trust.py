"""Scans placed by links as far as these can be trusted: less where they contradict each other, or scanners do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from torchreg.site.doubt import doubt
from torchreg.site.found import with_odds
from torchreg.site.links import Link
from torchreg.site.placement import Placement, place
from torchreg.site.sight import Stations, learned_stations
from torchreg.site.site_sight import SiteSight
from torchreg.site.tolerance import Tolerance

_DOUBTS = 4  # rounds of doubt
_LITTLE = 0.5  # log-odds: doubt below changes nothing
_SURVEYS, _SAME = 3, 0.05  # rounds of learning how far apart stations are, until that changes by no more
_BELIEVED = 0.5  # log-odds from what scanners saw, of links that this is learned from


class Trusted(NamedTuple):
    """Links as far as they can be trusted, and where they put the scans."""

    links: list[Link]
    placement: Placement
    doubt: float  # what was taken from the log-odds of all candidates


def placed(
    candidates: Sequence[Sequence[Link]], count: int, tolerance: Tolerance, sight: SiteSight | None = None
) -> Trusted:
    """Place scans by the candidates of every pair; where links contradict each other, all are trusted less.

    Where scanners are witnesses, the links that can be believed tell how far apart they stand, and all are weighed
    again by that.
    """
    if sight is not None:
        sight.stations = Stations()  # as nothing is known of them yet: what follows depends on the candidates alone
    trusted = _doubted(candidates, count, tolerance, sight)
    for _ in range(_SURVEYS if sight is not None else 0):
        used = zip(trusted.links, trusted.placement.used.tolist(), strict=True)
        learned = learned_stations([link.apart for link, is_used in used if is_used and link.sight > _BELIEVED])
        if sight is None or learned is None or abs(learned.apart - sight.stations.apart) < _SAME * learned.apart:
            break
        sight.stations = learned
        trusted = _doubted(candidates, count, tolerance, sight)
    return trusted


def _doubted(
    candidates: Sequence[Sequence[Link]], count: int, tolerance: Tolerance, sight: SiteSight | None
) -> Trusted:
    less, more = 0.0, 0.0
    for _ in range(_DOUBTS):
        less += more
        links = [link for pair in candidates for link in with_odds(pair, [_odds(one, sight) - less for one in pair])]
        placement = place(links, count, tolerance=tolerance, sight=sight)
        more = doubt(links, placement)
        if more < _LITTLE:
            break
    return Trusted(links, placement, less)


def _odds(link: Link, sight: SiteSight | None) -> float:
    """The log-odds of a candidate with what the places of its scanners say."""
    known = sight is not None and not math.isnan(link.apart)
    return link.log_odds + (sight.stations.odds(link.apart) if known else 0.0)  # type: ignore[union-attr]  # if known
