"""Many scans into one frame: ``register_site``.

scans -> which can be used                 ``scans``
      -> describe each once, all pairs     ``pairs``
      -> every candidate a link            ``found``
      -> the links that can be believed    ``place``
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from torchreg.errors import expect, expect_device
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import budget
from torchreg.site.found import links_of
from torchreg.site.links import Link
from torchreg.site.pairs import DescribedSite, Report, SiteProgress
from torchreg.site.placement import Placement, place
from torchreg.site.result import SiteLink, SiteResult, TriedPair
from torchreg.site.scans import SiteScans, site_scans
from torchreg.site.tolerance import Tolerance
from torchreg.types import Clouds

_ALIKE = 4.0  # inlier thresholds that poses of one kind are apart, at most


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
        effort: as for ``register``.
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
    seconds: dict[str, float] = {}
    with undisturbed(clouds[0].points):
        known = site_scans(clouds)
        site = DescribedSite(
            known, options, effort=effort, max_bytes=budget(max_bytes, clouds[0].device), report=report
        )
        seconds["describing"] = time.perf_counter() - begin
        links, pairs = _registered(site, seed, report)
        seconds["registering pairs"] = time.perf_counter() - begin - sum(seconds.values())
    report(SiteProgress("place", 0, len(clouds)))
    widest = max((pair.options.inlier_threshold for pair in site.pairs), default=1.0)
    placement = place(links, len(clouds), tolerance=Tolerance(meters=_ALIKE * widest))
    seconds["placing"] = time.perf_counter() - begin - sum(seconds.values())
    report(SiteProgress("place", len(clouds), len(clouds)))
    return _result(known, placement, links, pairs, seconds)


def _singles(scans: Clouds | Sequence[Clouds]) -> list[Clouds]:
    """The scans, each a batch of one."""
    clouds = scans.unpack() if isinstance(scans, Clouds) else list(scans)
    expect(len(clouds) > 0, "scans", "at least one cloud", clouds)
    for number, cloud in enumerate(clouds):
        single = isinstance(cloud, Clouds) and len(cloud) == 1
        expect(single, f"scans[{number}]", "Clouds of one cloud", cloud)
        expect_device(cloud.points, f"scans[{number}]", clouds[0].device)
    return clouds


def _registered(site: DescribedSite, seed: int, report: Report) -> tuple[list[Link], list[TriedPair]]:
    """The links of all pairs, and the pairs."""
    links: list[Link] = []
    tried: list[TriedPair] = []
    failed = 0
    report(SiteProgress("register", 0, len(site.pairs)))
    for pairs, result in site.registered(seed):
        for number, pair in enumerate(pairs):
            links += links_of(result, number, pair.source, pair.target)
            failed += not bool(result.success[number])
            tried.append(
                TriedPair(
                    pair.source,
                    pair.target,
                    bool(result.success[number]),
                    result.reason[number],
                    len(result.candidates[number]),
                )
            )
        report(SiteProgress("register", len(tried), len(site.pairs), failed))
    return links, tried


def _result(
    scans: SiteScans,
    placement: Placement,
    links: Sequence[Link],
    pairs: Sequence[TriedPair],
    seconds: dict[str, float],
) -> SiteResult:
    judged = zip(
        links,
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
