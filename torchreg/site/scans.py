"""The scans of a site as they were given: which can be used, and why the others cannot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torchreg.registration.inspect import CloudFacts, facts_of
from torchreg.registration.same_clouds import digest_of
from torchreg.registration.units import units_failure
from torchreg.types import Clouds


@dataclass(frozen=True, eq=False)
class SiteScans:
    """N scans, each a batch of one.

    Attributes:
        clouds: the scans.
        facts: of every scan.
        digests: of what every scan holds. They name a scan whatever its place among the others.
        trouble: why a scan cannot be used, in words; empty where it can.
        notes: remarks on every scan.
    """

    clouds: tuple[Clouds, ...]
    facts: tuple[CloudFacts, ...]
    digests: tuple[str, ...]
    trouble: tuple[str, ...]
    notes: tuple[tuple[str, ...], ...]

    def __len__(self) -> int:
        """The number of scans, N."""
        return len(self.clouds)

    def pairs(self) -> list[tuple[int, int]]:
        """All pairs (source, target) of usable scans, roles and order by what the scans hold, not by their places."""
        usable = sorted((scan for scan in range(len(self)) if not self.trouble[scan]), key=self.digests.__getitem__)
        return [(source, target) for place, target in enumerate(usable) for source in usable[place + 1 :]]

    def other_units(self, scan: int) -> str:
        """Why a scan seems to be in other units than most of the others; empty where it does not."""
        others = [other for other in range(len(self)) if other != scan and not self.trouble[other]]
        failures = [units_failure(self.facts[scan].lengths, self.facts[other].lengths) for other in others]
        refused = [(other, failure) for other, failure in zip(others, failures, strict=True) if failure is not None]
        if 2 * len(refused) <= len(others):
            return ""
        other, failure = refused[0]
        return failure.text.replace("the source", "the scan").replace("the target", f"scan {other}")


def site_scans(clouds: Sequence[Clouds]) -> SiteScans:
    """Look at every scan of a site, each a batch of one."""
    facts = tuple(facts_of(cloud)[0] for cloud in clouds)
    digests = tuple(digest_of(cloud) for cloud in clouds)
    first: dict[str, int] = {}
    trouble = []
    for scan, (one, digest) in enumerate(zip(facts, digests, strict=True)):
        original = first.setdefault(digest, scan)
        if one.defect is not None:
            trouble.append(one.defect.text.format("scan"))
        else:
            trouble.append("" if original == scan else f"a copy of scan {original}")
    some_colors = any(one.colors is not None for one in facts)
    notes = tuple(tuple(_notes(one, some_colors=some_colors)) for one in facts)
    return SiteScans(tuple(clouds), facts, digests, tuple(trouble), notes)


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
