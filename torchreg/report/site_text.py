"""A site in words: what is placed, what is not and why, and what to look at first."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

import torch

from torchreg.report.text import distance, legible
from torchreg.site.bridges import bridges
from torchreg.site.result import SiteResult

_SHOWN, _FEW = 5, 3
_ENOUGH = 4  # of which one can be unusual
_MUCH = 3.0  # times the median


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
    """What to look at first: what hangs by one link alone, links that pull against others, and what is held worst."""
    label = _labels(site, names)
    return [*_hanging(site, label), *_pulling(site, label), *_loose(site, label)]


def _hanging(site: SiteResult, label: Sequence[str]) -> list[str]:
    """A line for every link without which the site would fall apart, the least likely first."""
    used = [one.link for one in site.links if one.used]
    parts = sorted(bridges([(link.source, link.target) for link in used], len(site)), key=lambda bridge: bridge.number)
    parts.sort(key=lambda bridge: used[bridge.number].probability)
    lines = []
    for bridge in parts[:_SHOWN]:
        link = used[bridge.number]
        inside = link.source if link.source in bridge.smaller else link.target
        other = link.target if inside == link.source else link.source
        who = label[inside] if len(bridge.smaller) == 1 else f"{len(bridge.smaller)} scans, {label[inside]} among them,"
        verb = "hangs" if len(bridge.smaller) == 1 else "hang"
        lines.append(
            f"{who} {verb} by one link, to {label[other]} (probability {link.probability:.2f}): no other confirms it"
        )
    if len(parts) > _SHOWN:
        lines.append(f"more links that hold a part of the site alone: {len(parts) - _SHOWN}")
    return lines


def _pulling(site: SiteResult, label: Sequence[str]) -> list[str]:
    """Links that are off by much more than most, and than their own residual."""
    used = [one for one in site.links if one.used and math.isfinite(one.meters)]
    if len(used) < _ENOUGH:
        return []
    usual = statistics.median(one.meters for one in used)
    far = [one for one in used if one.meters > _MUCH * usual and not one.meters <= _MUCH * one.link.residual]
    far.sort(key=lambda one: -one.meters)
    return [
        f"the link of {label[one.link.source]} and {label[one.link.target]} is off by {distance(one.meters)}, most by "
        f"{distance(usual)}: it pulls against its neighbors"
        for one in far[:_FEW]
    ]


def _loose(site: SiteResult, label: Sequence[str]) -> list[str]:
    """The scans whose place is known much worse than that of most."""
    deviation = site.covariance[:, 3:, 3:].diagonal(dim1=1, dim2=2).sum(dim=1).sqrt().tolist()
    known = [scan for scan, value in enumerate(deviation) if math.isfinite(value) and value > 0]
    if len(known) < _ENOUGH:
        return []
    usual = statistics.median(deviation[scan] for scan in known)
    worst = sorted((scan for scan in known if deviation[scan] > _MUCH * usual), key=lambda scan: -deviation[scan])
    return [
        f"{label[scan]} is held loosely: its place is known to {distance(deviation[scan])}, most to {distance(usual)}"
        for scan in worst[:_FEW]
    ]


def _labels(site: SiteResult, names: Sequence[str] | None) -> list[str]:
    return [f"scan {number}" for number in range(len(site))] if names is None else [legible(name) for name in names]


def _listed(numbers: Sequence[int]) -> str:
    words = [f"{number:,}" for number in numbers]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
