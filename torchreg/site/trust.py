"""Scans placed by links as far as these can be trusted: less where they contradict each other, or scanners do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from torchreg.site.doubt import doubt
from torchreg.site.found import with_odds
from torchreg.site.links import Link
from torchreg.site.panorama import learned_neutral
from torchreg.site.placement import Placement, place
from torchreg.site.sight import learned_stations
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

    Where scanners are witnesses, and links do not contradict each other without them, what scanners saw under these
    links is taken for usual on this site, and speaks for other poses. The links that hold the poses then tell how far
    apart scanners stand, and all are weighed again by that.
    """
    if sight is None:
        return _doubted(candidates, count, tolerance, None)
    sight.forget()  # what follows depends on the candidates alone
    if sight.are_cameras():
        _learn_neutral(sight, _doubted(candidates, count, tolerance, None))
    trusted = _doubted(candidates, count, tolerance, sight)
    for _ in range(_SURVEYS):
        if not _learns_stations(sight, trusted):
            break
        trusted = _doubted(candidates, count, tolerance, sight)
    return _completed(trusted, count, tolerance, sight)


def roughly_placed(
    candidates: Sequence[Sequence[Link]], count: int, tolerance: Tolerance, sight: SiteSight | None = None
) -> Trusted:
    """As ``placed``, by what was learned of the stations from fewer candidates before: to see what is still missing."""
    trusted = _doubted(candidates, count, tolerance, sight)
    if sight is not None:
        _learns_stations(sight, trusted)
    return trusted


def _completed(trusted: Trusted, count: int, tolerance: Tolerance, sight: SiteSight) -> Trusted:
    """With what doubted links add that scanners speak for; how much is doubted is settled before."""
    if trusted.doubt == 0:
        return trusted
    whole = place(trusted.links, count, tolerance=tolerance, sight=sight, doubt=trusted.doubt)
    return trusted._replace(placement=whole)


def _learn_neutral(sight: SiteSight, trusted: Trusted) -> None:
    """Learn what right poses look like from links that loops confirm, where links do not contradict each other.

    Depth cameras are moved by hand and drift in exposure and depth: their right poses look worse than those of
    scanners that stand still and see all around, for which nothing is learned.
    """
    if trusted.doubt > 0:
        return
    placement = trusted.placement
    confirmed = zip(trusted.links, (placement.used & (placement.loops > 0)).tolist(), strict=True)
    links = [link for link, is_confirmed in confirmed if is_confirmed]
    links = [link for link in links if sight.has(link.source) and sight.has(link.target)]
    learned = learned_neutral([sight.compared(link.source, link.target, link.T_target_source) for link in links])
    if learned is not None:
        sight.neutral = learned


def _learns_stations(sight: SiteSight, trusted: Trusted) -> bool:
    """Learn from the links that hold the poses how far apart scanners stand; whether that is news."""
    used = zip(trusted.links, trusted.placement.used.tolist(), strict=True)
    learned = learned_stations([link.apart for link, is_used in used if is_used and link.sight > _BELIEVED])
    if learned is None or abs(learned.apart - sight.stations.apart) < _SAME * learned.apart:
        return False
    sight.stations = learned
    return True


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
