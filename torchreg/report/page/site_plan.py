"""The graph of a group of scans in plan, as SVG: scanners, links colored by their residual, refused pairs dashed.

Seen from above over a shadow of the points. What a line or a scan means is said when the pointer rests on it.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.report.page.markup import escaped, paragraph
from torchreg.report.page.plan_layout import PlanLayout, apart, plan_layout
from torchreg.report.page.site_frame import GroupFrame, scan_color
from torchreg.report.page.viewer import PALETTE
from torchreg.report.text import chance, counted, distance, legible
from torchreg.site.result import SiteLink, SiteResult, TriedPair
from torchreg.types import Clouds

CONTRADICTED = "its pose contradicts those of its neighbors"
"""Why a pair that was registered alone has no link all the same."""

_PER_SCAN = 1  # refused pairs that are drawn, for each scan: the likeliest
_BULGE, _MOST_BULGE = 0.1, 44.0  # of the length of a link, pixels: links over scans in a row are told apart
_LEFT, _RIGHT, _LINE = 110.0, 1020.0, 30.0  # pixels, of the rows of scans that are not placed
_FEWEST = 8  # places in such a row
_SIZES = ((30, 11.0), (120, 9.0), (10**9, 7.0))  # scans, radius of their circles
_ROUND = (1.0, 2.0, 5.0, 10.0)


def site_plan(
    site: SiteResult, frame: GroupFrame, scans: Sequence[Clouds], names: Sequence[str], missing: Sequence[int] = ()
) -> str:
    """The plan of one group as markup.

    Args:
        site: whose links are drawn.
        frame: of the group.
        scans: all of the site.
        names: of all scans.
        missing: scans that are not placed, which stand in a row below with their likeliest refused pairs.
    """
    radius = next(size for count, size in _SIZES if len(frame.members) + len(missing) <= count)
    rows = _rows(missing, 2 * radius + 4)
    below = rows[-1].y + _LINE if rows else 0.0
    layout = plan_layout(frame, scans, below=below)
    width, height = layout.size
    shown = apart(layout.scanners, 2 * radius + 2, (width, height - below))
    places = dict(zip(frame.members, shown, strict=True))
    places |= {scan: np.array((x, height - below + y)) for scan, x, y in rows}
    used = [one for one in site.links if one.used and one.link.source in places and one.link.target in places]
    best = _best(site)
    refused, left = _refused(site, places, best)
    top = _nice(max((one.link.residual for one in used if math.isfinite(one.link.residual)), default=0.0))
    parts = [
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="Plan of the scans and their links">',
        _shadow(layout),
        '<g class="refused">',
        *(
            _line(places, pair.source, pair.target, "#777", _refused_words(pair, best.get((pair.source, pair.target))))
            for pair in refused
        ),
        "</g>",
        '<g class="used">',
        *(
            _line(places, one.link.source, one.link.target, _shade(one.link.residual, top), _words(one))
            for one in sorted(used, key=lambda one: one.link.residual if math.isfinite(one.link.residual) else -1.0)
        ),
        "</g>",
        *_leaders(layout.scanners, shown),
        *(_scan(places[scan], radius, scan, names[scan], site) for scan in (*frame.members, *missing)),
        f'<text x="8" y="{height - below + _LINE + 5:.0f}" class="row">not placed:</text>' if missing else "",
        *_floor_labels(layout, frame),
        _ruler(layout),
        "</svg>",
    ]
    switch = '<label><input type="checkbox" checked> refused pairs (dashed)</label>' if refused else ""
    more = f"Of the refused pairs the {len(refused)} likeliest of {len(refused) + left} are drawn." if left else ""
    view = "Seen from above" if frame.upright else "Seen along the third axis, since up is not known"
    floor_by_floor = ", floor by floor" if layout.floors.any() else ""
    text = (
        f"{view}, over a shadow of the points{floor_by_floor}. A line is a link, its color the residual. Rest the "
        f"pointer on a line or a scan. {more}"
    )
    legend = _legend(top) if used else ""
    return f'<div class="plan">{switch}{"".join(parts)}{legend}{paragraph(text, "caption")}</div>'


class _Missing(NamedTuple):
    scan: int
    x: float  # pixels
    y: float  # below the plan


def _rows(missing: Sequence[int], gap: float) -> list[_Missing]:
    """Scans that are not placed, in rows."""
    gap = max(gap, (_RIGHT - _LEFT) / max(len(missing), _FEWEST))
    each = int((_RIGHT - _LEFT) / gap + 1e-9)
    return [
        _Missing(scan, _LEFT + (number % each) * gap, _LINE + (number // each) * gap)
        for number, scan in enumerate(missing)
    ]


def _floor_labels(layout: PlanLayout, frame: GroupFrame) -> list[str]:
    """How high the scanners of each floor stand above those of the lowest; nothing for one floor."""
    heights = [
        float(np.median(frame.scanners[layout.floors == floor, 2])) for floor in range(int(layout.floors.max()) + 1)
    ]
    words = ["the lowest floor", *(f"{height - heights[0]:.1f} m higher" for height in heights[1:])]
    return [
        f'<text x="{x:.1f}" y="{y + 4:.1f}" class="floor">{text}</text>'
        for text, (x, y) in zip(words, layout.corners, strict=True)
        if len(words) > 1
    ]


def _shadow(layout: PlanLayout) -> str:
    """The density of the points as a pale picture."""
    from matplotlib.image import imsave

    width, height = (round(value / 2) for value in layout.size)
    at = np.floor(layout.points / 2).astype(int)
    inside = ((at >= 0) & (at < (width, height))).all(axis=1)
    counts = np.bincount(at[inside, 1] * width + at[inside, 0], minlength=width * height).reshape(height, width)
    full = float(np.quantile(counts[counts > 0], 0.98)) if counts.any() else 1.0
    shade = np.full((height, width, 4), 90, dtype=np.uint8)
    shade[..., 3] = np.round(120 * np.clip(np.log1p(counts) / np.log1p(full), 0, 1))
    file = io.BytesIO()
    imsave(file, shade, format="png")
    content = base64.b64encode(file.getvalue()).decode()
    return (
        f'<image width="{layout.size[0]:.0f}" height="{layout.size[1]:.0f}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{content}"/>'
    )


def _refused(
    site: SiteResult, places: dict[int, NDArray[Any]], best: dict[tuple[int, int], float]
) -> tuple[list[TriedPair], int]:
    """The likeliest pairs that no used link joins, between scans of the plan, and how many more there are."""
    joined = {(one.link.source, one.link.target) for one in site.links if one.used}
    pairs = [
        pair
        for pair in site.pairs
        if (pair.source, pair.target) not in joined and pair.source in places and pair.target in places
    ]
    pairs.sort(key=lambda pair: (-best.get((pair.source, pair.target), 0.0), pair.source, pair.target))
    most = _PER_SCAN * len(places)
    return pairs[:most], max(0, len(pairs) - most)


def _best(site: SiteResult) -> dict[tuple[int, int], float]:
    """The probability of the likeliest candidate of each pair that has one, by source and target."""
    best: dict[tuple[int, int], float] = {}
    for one in site.links:
        key = one.link.source, one.link.target
        best[key] = max(best.get(key, 0.0), one.link.probability)
    return best


def _refused_words(pair: TriedPair, best: float | None) -> str:
    likely = f" Its best candidate has a probability of {chance(best)}." if best is not None else ""
    return f"scans {pair.source} and {pair.target}, no link: {pair.reason or CONTRADICTED}.{likely}"


def _words(one: SiteLink) -> str:
    link = one.link
    parts = [f"scans {link.source} and {link.target}", f"probability {chance(link.probability)}"]
    parts += [f"overlap {link.overlap:.0%}"] * math.isfinite(link.overlap)
    parts += [f"residual {distance(link.residual)}"] * math.isfinite(link.residual)
    parts += [f"off by {distance(one.meters)}"] * math.isfinite(one.meters)
    loops = f"{counted(one.loops, 'loop')} of three close within {distance(one.loop_meters)}"
    return ", ".join([*parts, loops if one.loops else "no loop confirms it"])


def _line(places: dict[int, NDArray[Any]], source: int, target: int, color: str, words: str) -> str:
    (x1, y1), (x2, y2) = places[min(source, target)], places[max(source, target)]
    aside = min(2 * _BULGE, _MOST_BULGE / max(math.hypot(x2 - x1, y2 - y1), 1e-9))
    x, y = (x1 + x2) / 2 - aside * (y2 - y1), (y1 + y2) / 2 + aside * (x2 - x1)
    way = f'd="M{x1:.1f} {y1:.1f}Q{x:.1f} {y:.1f} {x2:.1f} {y2:.1f}"'
    return f'<g><title>{escaped(legible(words))}</title><path {way} class="hit"/><path {way} stroke="{color}"/></g>'


def _leaders(true: NDArray[Any], shown: NDArray[Any]) -> list[str]:
    """From scans that had to make room to where they are."""
    lines = []
    for (x1, y1), (x2, y2) in zip(true, shown, strict=True):
        if math.hypot(x2 - x1, y2 - y1) > 3:
            lines.append(f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" class="leader"/>')
            lines.append(f'<circle cx="{x1:.1f}" cy="{y1:.1f}" r="2" class="spot"/>')
    return lines


def _scan(place: NDArray[Any], radius: float, scan: int, name: str, site: SiteResult) -> str:
    placed = int(site.group[scan]) >= 0
    words = f"{scan}: {name}" + ("" if placed else f", not placed: {site.reason[scan]}")
    if placed and int(site.group.max()) > 0:
        words += f", group {int(site.group[scan])}"
    fill = scan_color(scan) if placed else "#fff"
    size = radius * (1.15 if scan < 100 else 0.85)
    return (
        f'<g class="{"scan" if placed else "scan missing"}"><title>{escaped(legible(words))}</title>'
        f'<circle cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="{radius}" fill="{fill}"/>'
        f'<text x="{place[0]:.1f}" y="{place[1] + 0.36 * size:.1f}" font-size="{size:.1f}">{scan}</text></g>'
    )


def _nice(value: float) -> float:
    """The value rounded up to one digit of 1, 2 or 5."""
    if value <= 0:
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in _ROUND if step * power >= value * (1 - 1e-9))


def _shade(residual: float, top: float) -> str:
    """From the first color of the palette at a residual of 0 to the last at ``top``; gray where it is not known."""
    if not math.isfinite(residual) or top <= 0:
        return "#555"
    at = min(residual / top, 1.0) * (len(PALETTE) - 1)
    low = min(int(at), len(PALETTE) - 2)
    ends = [np.array(list(bytes.fromhex(PALETTE[low + k][1:])), dtype=float) for k in (0, 1)]
    mixed = ends[0] * (low + 1 - at) + ends[1] * (at - low)
    return "#" + bytes(np.round(mixed).astype(np.uint8)).hex()


def _legend(top: float) -> str:
    if top <= 0:
        return ""
    ends = "".join(f"<span>{escaped(distance(top * part) if part else '0')}</span>" for part in (0.0, 0.5, 1.0))
    return (
        f'<div class="viewer-scale">Residual of the links<div class="bar" style="background:linear-gradient(to right,'
        f'{",".join(PALETTE)})"></div><div class="ends">{ends}</div></div>'
    )


def _ruler(layout: PlanLayout) -> str:
    """A bar of a round length."""
    meters = _nice(0.06 * layout.size[0] / layout.scale)
    length = meters * layout.scale
    x, y = layout.size[0] - length - 12, 16
    return (
        f'<g class="ruler"><line x1="{x:.1f}" y1="{y}" x2="{x + length:.1f}" y2="{y}"/>'
        f'<text x="{x + length / 2:.1f}" y="{y + 14}">{meters:g} m</text></g>'
    )
