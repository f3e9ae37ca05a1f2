"""Many scans into one frame: ``register_site``."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from torchreg.entry import entry
from torchreg.errors import expect, expect_device, one_of
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import budget
from torchreg.site.frame import SiteFrame
from torchreg.site.pairs import PairPlan, Report
from torchreg.site.result import SiteResult
from torchreg.site.scans import look_at, site_scans
from torchreg.site.solve import solved
from torchreg.site.work import WorkInMemory
from torchreg.types import Clouds
from torchreg.verification import WORK


@entry
def register_site(
    scans: Clouds | Sequence[Clouds],
    options: RegistrationOptions | None = None,
    *,
    effort: str | None = None,
    frame: SiteFrame | None = None,
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
            balanced where they are plain, which weighs no pose; where they are derived, balanced, and fast for sites
            of more than 32 scans.
        frame: a scan that is fixed, known poses, control points, or that z is up; by default the first scan of every
            group has the identity.
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
    chosen = effort_of(options, effort)
    with undisturbed(clouds[0].points):
        known = site_scans([look_at(cloud, scaled=options is None) for cloud in clouds])
        looking = time.perf_counter() - begin
        plan = PairPlan(known, options, chosen)
        work = WorkInMemory(clouds, max_bytes=budget(max_bytes, clouds[0].device), report=report)
        result = solved(known, plan, work, frame=frame or SiteFrame(), seed=seed, report=report)
    return replace(result, seconds=(("looking", looking), *result.seconds))


def effort_of(options: RegistrationOptions | None, effort: str | None) -> str | None:
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
