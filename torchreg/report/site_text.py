"""A site in words: what is placed, what is not and why, and what to look at first."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from torchreg.report.text import legible
from torchreg.site.result import SiteLink, SiteResult

_SHOWN = 5


def summary_of(site: SiteResult, names: Sequence[str] | None = None) -> str:
    """Say in words which scans are placed, which are not and why, and what to look at first.

    ``names`` are those of the scans; numbers from 0 by default.
    """
    return "\n".join([*verdict_lines(site), *missing_lines(site, names), *doubts(site, names)])


def verdict_lines(site: SiteResult) -> list[str]:
    """How many scans are placed, in how many frames, from what."""
    sizes = torch.bincount(site.group[site.placed]).tolist()
    placed = sum(sizes)
    if placed == 0:
        first = f"none of {len(site):,} scans could be placed"
    elif placed == len(site) and len(sizes) == 1:
        first = f"all {len(site):,} scans are placed in one frame"
    else:
        frames = (
            "one frame" if len(sizes) == 1 else f"{len(sizes)} frames that do not connect, of {_listed(sizes)} scans"
        )
        first = f"{placed:,} of {len(site):,} scans are placed in {frames}"
    used = [link for link in site.links if link.used]
    looped = sum(link.loops > 0 for link in used)
    lines = [first]
    if site.pairs:
        lines.append(
            f"{len(used):,} of {len(site.pairs):,} pairs of scans hold them; loops confirm {looped:,} of these links"
        )
    if site.doubt > 0:
        lines.append(
            "places of this site look alike: links that seem sure contradict each other, so all are trusted less"
        )
    return lines


def missing_lines(site: SiteResult, names: Sequence[str] | None = None) -> list[str]:
    """A line for every scan that is not placed, and why."""
    label = _labels(site, names)
    return [f"{label[scan]} is not placed: {why}" for scan, why in enumerate(site.reason) if why]


def doubts(site: SiteResult, names: Sequence[str] | None = None) -> list[str]:
    """What to look at first: scans that hang by one link alone."""
    label = _labels(site, names)
    lines = []
    by_scan: dict[int, list[SiteLink]] = {}
    for link in site.links:
        if link.used:
            by_scan.setdefault(link.link.source, []).append(link)
            by_scan.setdefault(link.link.target, []).append(link)
    weak = [scan for scan, links in sorted(by_scan.items()) if len(links) == 1]
    for scan in weak[:_SHOWN]:
        only = by_scan[scan][0].link
        other = only.source if only.target == scan else only.target
        lines.append(
            f"{label[scan]} hangs by one link, to {label[other]} (probability {only.probability:.2f}): "
            "no other confirms it"
        )
    if len(weak) > _SHOWN:
        lines.append(f"and {len(weak) - _SHOWN} more scans hang by one link")
    return lines


def _labels(site: SiteResult, names: Sequence[str] | None) -> list[str]:
    return [f"scan {number}" for number in range(len(site))] if names is None else [legible(name) for name in names]


def _listed(numbers: Sequence[int]) -> str:
    words = [f"{number:,}" for number in numbers]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
