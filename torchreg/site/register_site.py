"""Many scans into one frame: ``register_site``.

scans -> which can be used                 ``scans``
      -> describe each once, all pairs     ``pairs``
      -> every candidate a link            ``found``
      -> the links that can be believed    ``placement``, less where they contradict each other (``doubt``)
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import torch

from torchreg.errors import expect, expect_device, one_of
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import budget
from torchreg.site.doubt import doubt
from torchreg.site.found import has_chance, links_of, refined_link, weighed, with_odds
from torchreg.site.links import Link
from torchreg.site.pairs import DescribedSite, Report, SitePair, SiteProgress
from torchreg.site.placement import Placement, place
from torchreg.site.result import SiteLink, SiteResult, TriedPair
from torchreg.site.scans import SiteScans, site_scans
from torchreg.site.tolerance import Tolerance
from torchreg.types import Clouds
from torchreg.verification import WORK

_ALIKE = 2.0  # inlier thresholds that poses held to be one are apart, besides what their covariances allow
_DEGREES = 2.0  # likewise
_ROUNDS = 4  # of doubt
_LITTLE = 0.5  # log-odds: doubt below changes nothing


def register_site(
    scans: Clouds | Sequence[Clouds],
    options: RegistrationOptions | None = None,
    *,
    effort: str | None = None,
    seed: int = 0,
    max_bytes: int | None = None,
    report: Report = lambda _: None,
) -> SiteResult:
    """Put scans of a site into one frame, without any first guess or order.

    All pairs are registered, as ``register`` does, and every pose that was weighed for a pair counts as a candidate.
    Those that agree with each other decide: loops confirm poses that a pair alone leaves in doubt, and refute poses
    that it takes for right. Scans that no link holds are left out with a reason; groups that do not connect stay apart.

    Args:
        scans: N clouds, packed or one by one; colors are used for pairs in which both have them.
        options: in meters, for all pairs; ``None`` derives them from the spacing of the points, one scale for scans of
            about one spacing, so that each is described once.
        effort: ``"fast"``, ``"balanced"`` or ``"thorough"``, as for ``register``; ``None`` takes that of the options,
            and balanced where they are derived or plain, which weighs no pose.
        seed: of every random draw. The same seed gives the same bits, for any number of threads; another order of the
            scans gives the same poses, but for the frame and the last digits (nanometers).
        max_bytes: about the memory to work in, beyond the scans and their descriptions; ``None`` takes a quarter of
            what is free.
        report: called at every step with a ``SiteProgress``.

    Returns:
        SiteResult. A scan that cannot be used, such as an empty one or a copy, is named with its reason and does not
        affect the others. No gradients.

    Raises:
        ValueError: no scans, an entry that is not one cloud, scans on several devices, or options that do not fit.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> tr.register_site([pair.source, pair.target]).T_world_scan.shape
        torch.Size([2, 4, 4])
    """
    begin = time.perf_counter()
    clouds = _singles(scans)
    effort = _effort(options, effort)
    seconds: dict[str, float] = {}
    with undisturbed(clouds[0].points):
        known = site_scans(clouds)
        site = DescribedSite(
            known, options, effort=effort, max_bytes=budget(max_bytes, clouds[0].device), report=report
        )
        seconds["describing"] = time.perf_counter() - begin
        candidates, pairs = _registered(site, seed, report)
        seconds["registering pairs"] = time.perf_counter() - begin - sum(seconds.values())
        report(SiteProgress("place", 0, len(clouds)))
        trusted = _placed(site, candidates, len(clouds))
    seconds["placing"] = time.perf_counter() - begin - sum(seconds.values())
    report(SiteProgress("place", len(clouds), len(clouds)))
    return _result(known, trusted, pairs, seconds)


class _Trusted(NamedTuple):
    """Links as far as they can be trusted, and where they put the scans."""

    links: list[Link]
    placement: Placement
    doubt: float


def _placed(site: DescribedSite, candidates: Sequence[Sequence[Link]], count: int) -> _Trusted:
    """Place scans by the candidates of every pair; where links contradict each other, all are trusted less."""
    widest = max((pair.options.inlier_threshold for pair in site.pairs), default=1.0)
    tolerance = Tolerance(meters=_ALIKE * widest, degrees=_DEGREES)
    less = 0.0
    for _ in range(_ROUNDS):
        links = [link for pair in candidates for link in with_odds(pair, [one.log_odds - less for one in pair])]
        placement = place(links, count, tolerance=tolerance)
        more = doubt(links, placement)
        if more < _LITTLE:
            break
        less += more
    return _Trusted(links, placement, less)


def _effort(options: RegistrationOptions | None, effort: str | None) -> str | None:
    """An effort at which poses are weighed on the clouds; ``None`` for that of the options."""
    if effort is not None:
        return one_of(effort, "effort", tuple(WORK))
    return "balanced" if options is not None and options.effort not in WORK else None


def _singles(scans: Clouds | Sequence[Clouds]) -> list[Clouds]:
    """The scans, each a batch of one."""
    clouds = scans.unpack() if isinstance(scans, Clouds) else list(scans)
    expect(len(clouds) > 0, "scans", "at least one cloud", clouds)
    for number, cloud in enumerate(clouds):
        single = isinstance(cloud, Clouds) and len(cloud) == 1
        expect(single, f"scans[{number}]", "Clouds of one cloud", cloud)
        expect_device(cloud.points, f"scans[{number}]", clouds[0].device)
    return clouds


def _registered(site: DescribedSite, seed: int, report: Report) -> tuple[list[list[Link]], list[TriedPair]]:
    """The candidates of every pair as links, those with a chance refined, and the pairs."""
    candidates: list[list[Link]] = []
    tried: list[TriedPair] = []
    failed = 0
    report(SiteProgress("register", 0, len(site.pairs)))
    for pairs, result in site.registered(seed):
        links = [links_of(result, number, pair.source, pair.target) for number, pair in enumerate(pairs)]
        refined = _refined(site, pairs, links)
        candidates += [
            own if pair.options.refine == "none" else weighed(own) for pair, own in zip(pairs, refined, strict=True)
        ]
        for number, pair in enumerate(pairs):
            success, reason = bool(result.success[number]), result.reason[number]
            tried.append(TriedPair(pair.source, pair.target, success, reason, len(result.candidates[number])))
            failed += not success
        report(SiteProgress("register", len(tried), len(site.pairs), failed))
    return candidates, tried


def _refined(site: DescribedSite, pairs: Sequence[SitePair], links: Sequence[list[Link]]) -> Sequence[list[Link]]:
    """The candidates of pairs, those with a chance refined where that can be."""
    wanted = [(row, rank) for row, own in enumerate(links) for rank, link in enumerate(own) if has_chance(link)]
    if wanted:
        T = torch.stack([links[row][rank].T_target_source for row, rank in wanted])
        for places, refined in site.refined([pairs[row] for row, _ in wanted], T):
            for number, place_ in enumerate(places):
                row, rank = wanted[place_]
                links[row][rank] = refined_link(links[row][rank], refined, number)
    return links


def _result(scans: SiteScans, trusted: _Trusted, pairs: Sequence[TriedPair], seconds: dict[str, float]) -> SiteResult:
    placement = trusted.placement
    judged = zip(
        trusted.links,
        placement.used.tolist(),
        placement.weight.tolist(),
        placement.meters.tolist(),
        placement.degrees.tolist(),
        placement.loops.tolist(),
        placement.loop_meters.tolist(),
        placement.loop_degrees.tolist(),
        strict=True,
    )
    return SiteResult(
        T_world_scan=placement.T_world_scan,
        group=placement.group,
        covariance=placement.covariance,
        center=placement.center,
        reason=tuple(_reason(scans, scan, why) for scan, why in enumerate(placement.reason)),
        notes=scans.notes,
        links=tuple(SiteLink(*each) for each in judged),
        pairs=tuple(pairs),
        scale=placement.scale,
        doubt=trusted.doubt,
        seconds=tuple(seconds.items()),
    )


def _reason(scans: SiteScans, scan: int, why: str) -> str:
    """Why a scan is not placed: what is wrong with it alone says more than that no link was found."""
    if not why:
        return ""
    if scans.trouble[scan]:
        return scans.trouble[scan]
    usable = sum(not trouble for trouble in scans.trouble)
    if usable == 1 < len(scans):
        return "it is the only scan that can be used"
    return scans.other_units(scan) or why
