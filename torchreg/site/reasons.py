"""Why a scan is not placed, in words."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from torchreg.site.graph import SiteGraph
from torchreg.site.links import Link


def reasons_of(graph: SiteGraph, links: Sequence[Link], placed: Tensor) -> tuple[str, ...]:
    """Why each scan is not placed; empty where ``placed`` (N,)."""
    likeliest: dict[int, Link] = {}
    for row in sorted(range(len(graph)), key=lambda row: (-float(graph.evidence[row]), row)):
        number = int(graph.number[row])
        if number < len(links):
            for scan in (links[number].target, links[number].source):
                likeliest.setdefault(scan, links[number])
    return tuple(
        "" if fine else _reason(likeliest.get(scan), scan, graph.count) for scan, fine in enumerate(placed.tolist())
    )


def _reason(link: Link | None, scan: int, count: int) -> str:
    if count == 1:
        return "it is the only scan"
    if link is None:
        return "no pose to any other scan was found"
    other = link.source if link.target == scan else link.target
    why = f", refused as {link.reason}" if link.reason else ""
    words = f"the best, to scan {other}, has a probability of {link.probability:.2g}{why}"
    doubtful = link.probability < 0.5 or link.log_odds < 0
    return f"{'no link is likely enough' if doubtful else 'links contradict each other'}: {words}"
