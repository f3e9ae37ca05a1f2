"""The scans of a site as they were given: what is known of each, which can be used, and why the others cannot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from torchreg.errors import expect
from torchreg.registration.inspect import CloudFacts, facts_of
from torchreg.registration.same_clouds import digest_of
from torchreg.registration.scales import Scale, coarse_scale_of, scale_of
from torchreg.registration.units import units_failure
from torchreg.types import Clouds

COARSE_POINTS = 6_000
"""Of a scan of a large site, at most."""


class ScanLook(NamedTuple):
    """What is known of a scan before it is described.

    Attributes:
        facts: of the scan as it was given.
        digest: of what it holds. It names a scan whatever its place among the others.
        scale: of its points; ``None`` where it was not asked for, or the scan cannot be used.
        coarse: likewise, thinned to ``COARSE_POINTS``: in large sites a pair must not take long.
    """

    facts: CloudFacts
    digest: str
    scale: Scale | None
    coarse: Scale | None

    @property
    def colored(self) -> bool:
        """Whether the scan has colors."""
        return self.facts.colors is not None


def look_at(cloud: Clouds, *, scaled: bool) -> ScanLook:
    """Look at a scan, a batch of one; ``scaled`` asks for its scale."""
    facts = facts_of(cloud)[0]
    scaled = scaled and facts.defect is None
    scales = (scale_of(cloud), coarse_scale_of(cloud, COARSE_POINTS)) if scaled else (None, None)
    return ScanLook(facts, digest_of(cloud), *scales)


@dataclass(frozen=True, eq=False)
class SiteScans:
    """What is known of N scans.

    Attributes:
        looks: at every scan; ``None`` where it could not be read.
        trouble: why a scan cannot be used, in words; empty where it can.
        notes: remarks on every scan.
    """

    looks: tuple[ScanLook | None, ...]
    trouble: tuple[str, ...]
    notes: tuple[tuple[str, ...], ...]

    def __len__(self) -> int:
        """The number of scans, N."""
        return len(self.looks)

    def look(self, scan: int) -> ScanLook:
        """The look at a scan that could be read."""
        look = self.looks[scan]
        expect(look is not None, "scan", "one that could be read", scan)
        return look  # type: ignore[return-value]  # just checked

    def usable(self) -> list[int]:
        """The scans that can be used, in an order that follows from what they hold, not from their places."""
        return sorted((scan for scan in range(len(self)) if not self.trouble[scan]), key=lambda k: self.look(k).digest)

    def other_units(self, scan: int) -> str:
        """Why a scan seems to be in other units than most of the others; empty where it does not."""
        others = [other for other in range(len(self)) if other != scan and not self.trouble[other]]
        own = self.look(scan).facts.lengths
        failures = [units_failure(own, self.look(other).facts.lengths) for other in others]
        refused = [(other, failure) for other, failure in zip(others, failures, strict=True) if failure is not None]
        if 2 * len(refused) <= len(others):
            return ""
        other, failure = refused[0]
        return failure.text.replace("the source", "the scan").replace("the target", f"scan {other}")


def site_scans(looks: Sequence[ScanLook | None], unreadable: Sequence[str] | None = None) -> SiteScans:
    """What follows from the looks at all scans of a site; ``unreadable`` says why there is none at a scan."""
    first: dict[str, int] = {}
    trouble = []
    for scan, look in enumerate(looks):
        if look is None:
            trouble.append("it cannot be read" if unreadable is None else unreadable[scan])
            continue
        original = first.setdefault(look.digest, scan)
        if look.facts.defect is not None:
            trouble.append(look.facts.defect.text.format("scan"))
        else:
            trouble.append("" if original == scan else f"a copy of scan {original}")
    some_colors = any(look is not None and look.colored for look in looks)
    notes = tuple(() if look is None else tuple(_notes(look.facts, some_colors=some_colors)) for look in looks)
    return SiteScans(tuple(looks), tuple(trouble), notes)


def _notes(facts: CloudFacts, *, some_colors: bool) -> list[str]:
    """Remarks on one scan, in a site of which some scans have colors or none has."""
    notes: list[str] = []
    if facts.defect is not None:
        return notes
    if some_colors and facts.colors is None:
        notes.append("no colors: its pairs are matched by geometry alone")
    if facts.assumed:
        notes.append("the scanner's position is only assumed: free space is no evidence")
    elif not facts.faced:
        notes.append("no scanner position: normals are turned to the mean point")
    if facts.colors is not None and (facts.colors[0] < 0 or facts.colors[1] > 1):
        notes.append(f"colors from {facts.colors[0]:.3g} to {facts.colors[1]:.3g}: expected 0 to 1")
    return notes
