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
from torchreg.report.page.site_frame import GroupFrame, scan_color
from torchreg.report.page.viewer import PALETTE
from torchreg.report.scene import thin
from torchreg.report.text import chance, counted, distance, legible
from torchreg.site.result import SiteLink, SiteResult, TriedPair
from torchreg.types import Clouds

CONTRADICTED = "its pose contradicts those of its neighbors"
"""Why a pair that was registered alone has no link all the same."""

_WIDTH, _LEAST_HEIGHT, _MOST_HEIGHT = 1040.0, 260.0, 780.0  # of the drawing
_MARGIN = 26.0
_SHADOW_POINTS = 30_000  # of each scan
_PER_SCAN = 1  # refused pairs that are drawn, for each scan: the likeliest
_ROW = 60.0  # height of the row of scans that are not placed
_TALLER = 1.6  # a drawing of several floors
_ROOM = 2.5  # meters from floor to floor, at least
_OFTEN = 0.1  # of the scanners stand on a floor
_SPAN = (0.02, 0.98)  # of the points are drawn, and what lies near them
_BEYOND = 0.06
_AROUND, _SEEN = 1.5, 1.3  # extents of the scanners, distances to the middle of the points that are drawn around them
_BULGE, _MOST_BULGE = 0.1, 44.0  # of the length of a link, pixels: links over scans in a row are told apart
_LATTICE = 60  # places tried along the way out of a crowd
_SIZES = ((30, 11.0), (120, 9.0), (10**9, 7.0))  # scans, radius of their circles
_ROUND = (1.0, 2.0, 5.0, 10.0)


class _Canvas(NamedTuple):
    low: NDArray[Any]  # (2,) meters, the left lower corner
    scale: float  # pixels a meter
    size: tuple[float, float]

    def at(self, places: NDArray[Any]) -> NDArray[Any]:
        """Pixels (N, 2) of places (N, 2) in meters."""
        flat = (places - self.low) * self.scale
        return np.stack((_MARGIN + flat[:, 0], self.size[1] - _MARGIN - flat[:, 1]), axis=1)


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
    floors = _floors(frame.scanners[:, 2]) if frame.upright else np.zeros(len(frame.members), dtype=int)
    flat = _flat(frame, scans, floors)
    canvas, shadow = _canvas(flat, int(floors.max()) + 1, bool(missing)), flat.points
    radius = next(size for count, size in _SIZES if len(frame.members) + len(missing) <= count)
    true = canvas.at(flat.scanners)
    shown = _apart(true, 2 * radius + 2, (canvas.size[0], canvas.size[1] - (_ROW if missing else 0.0)))
    places = dict(zip(frame.members, shown, strict=True))
    for number, scan in enumerate(missing):
        across = (canvas.size[0] - 180) * (number + 0.5) / len(missing) + 150
        places[scan] = np.array((across, canvas.size[1] - 24))
    used = [one for one in site.links if one.used and one.link.source in places and one.link.target in places]
    best = _best(site)
    refused, left = _refused(site, places, best)
    top = _nice(max((one.link.residual for one in used if math.isfinite(one.link.residual)), default=0.0))
    width, height = canvas.size
    parts = [
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="Plan of the scans and their links">',
        _shadow(canvas, shadow),
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
        *_leaders(true, shown),
        *(_scan(places[scan], radius, scan, names[scan], site) for scan in (*frame.members, *missing)),
        f'<text x="8" y="{height - 20:.0f}" class="row">not placed:</text>' if missing else "",
        *(_floor_label(canvas, frame, floors, floor, flat) for floor in range(int(floors.max()) + 1) if floors.any()),
        _ruler(canvas),
        "</svg>",
    ]
    switch = '<label><input type="checkbox" checked> refused pairs (dashed)</label>' if refused else ""
    more = f"Of the refused pairs the {len(refused)} likeliest of {len(refused) + left} are drawn." if left else ""
    view = "Seen from above" if frame.upright else "Seen along the third axis, since up is not known"
    floor_by_floor = ", floor by floor" if floors.any() else ""
    text = (
        f"{view}, over a shadow of the points{floor_by_floor}. A line is a link, its color the residual. Rest the "
        f"pointer on a line or a scan. {more}"
    )
    legend = _legend(top) if used else ""
    return f'<div class="plan">{switch}{"".join(parts)}{legend}{paragraph(text, "caption")}</div>'


def _floors(heights: NDArray[Any]) -> NDArray[np.int64]:
    """The number of the floor of each scanner, the lowest 0, from heights (M,): where many stand, and what is near."""
    levels: list[float] = []
    left = heights.copy()
    while len(left):
        near = np.abs(left[:, None] - left[None]) < _ROOM / 4
        level = float(np.median(left[near[int(np.argmax(near.sum(axis=1)))]]))
        together = np.abs(left - level) < _ROOM / 4
        if levels and together.sum() < max(2, _OFTEN * len(heights)):
            break
        if not levels or min(abs(level - other) for other in levels) >= _ROOM * 0.8:
            levels.append(level)
        left = left[~together]
    numbers: NDArray[np.int64] = np.argmin(np.abs(heights[:, None] - np.sort(levels)[None]), axis=1)
    return numbers


class _Flat(NamedTuple):
    """Floors side by side: the second coordinate of each is shifted, higher floors above lower ones."""

    scanners: NDArray[Any]  # (M, 2)
    points: NDArray[Any]  # (N, 2)
    low: NDArray[Any]  # (2,) of what is drawn of one floor
    high: NDArray[Any]
    pitch: float  # from floor to floor


def _flat(frame: GroupFrame, scans: Sequence[Clouds], floors: NDArray[np.int64]) -> _Flat:
    parts = [np.empty((0, 2))]
    for scan, pose in zip(frame.members, frame.poses, strict=True):
        every = scans[scan].points.detach().cpu().double().numpy()
        parts.append((every[thin(every, _SHADOW_POINTS)] @ pose[:3, :3].T + pose[:3, 3])[:, :2])
    points = np.concatenate(parts)
    low, high = frame.scanners[:, :2].min(axis=0), frame.scanners[:, :2].max(axis=0)
    if len(points):
        lowest, highest = np.quantile(points, _SPAN, axis=0)
        pad = _BEYOND * float((highest - lowest).max())
        middle, reach = (low + high) / 2, _AROUND * float((high - low).max())
        reach = max(reach, _SEEN * float(np.abs(np.median(points, axis=0) - middle).max()))  # what is looked at is seen
        low = np.minimum(low, np.maximum(lowest - pad, middle - reach))
        high = np.maximum(high, np.minimum(highest + pad, middle + reach))
    pitch = 1.08 * float(high[1] - low[1])
    inside = [((part >= low) & (part <= high)).all(axis=1) for part in parts]
    rows = [part[keep] for part, keep in zip(parts, inside, strict=True)]
    for part, floor in zip(rows[1:], floors, strict=True):
        part[:, 1] += pitch * floor
    scanners = frame.scanners[:, :2] + np.stack((np.zeros(len(floors)), pitch * floors), axis=1)
    return _Flat(scanners, np.concatenate(rows), low, high, pitch)


def _canvas(flat: _Flat, floors: int, row: bool) -> _Canvas:
    low, high = flat.low, flat.high + np.array((0.0, flat.pitch * (floors - 1)))
    extent = np.maximum(high - low, 1e-6)
    tallest = _MOST_HEIGHT * (1 if floors == 1 else _TALLER)
    scale = min((_WIDTH - 2 * _MARGIN) / extent[0], (tallest - 2 * _MARGIN) / extent[1])
    height = max(extent[1] * scale + 2 * _MARGIN, _LEAST_HEIGHT)
    spare = np.array((_WIDTH - 2 * _MARGIN - extent[0] * scale, height - 2 * _MARGIN - extent[1] * scale)) / 2 / scale
    bottom = _ROW if row else 0.0
    return _Canvas(low - spare - np.array((0.0, bottom / scale)), scale, (_WIDTH, height + bottom))


def _floor_label(canvas: _Canvas, frame: GroupFrame, floors: NDArray[np.int64], floor: int, flat: _Flat) -> str:
    """How high the scanners of a floor stand above those of the lowest."""
    heights = [float(np.median(frame.scanners[floors == number, 2])) for number in (0, floor)]
    ((x, y),) = canvas.at(np.array([[flat.low[0], flat.high[1] + flat.pitch * floor]]))
    words = "the lowest floor" if floor == 0 else f"{heights[1] - heights[0]:.1f} m higher"
    return f'<text x="{x:.1f}" y="{y + 4:.1f}" class="floor">{words}</text>'


def _shadow(canvas: _Canvas, points: NDArray[Any]) -> str:
    """The density of the points as a pale picture."""
    from matplotlib.image import imsave

    width, height = (round(value / 2) for value in canvas.size)
    at = np.floor(canvas.at(points) / 2).astype(int)
    inside = ((at >= 0) & (at < (width, height))).all(axis=1)
    counts = np.bincount(at[inside, 1] * width + at[inside, 0], minlength=width * height).reshape(height, width)
    dark = np.log1p(counts) / max(float(np.log1p(np.quantile(counts[counts > 0], 0.98))) if counts.any() else 1.0, 1e-9)
    shade = np.full((height, width, 4), 90, dtype=np.uint8)
    shade[..., 3] = np.round(120 * np.clip(dark, 0, 1))
    file = io.BytesIO()
    imsave(file, shade, format="png")
    content = base64.b64encode(file.getvalue()).decode()
    return (
        f'<image width="{canvas.size[0]:.0f}" height="{canvas.size[1]:.0f}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{content}"/>'
    )


def _apart(true: NDArray[Any], gap: float, size: tuple[float, ...]) -> NDArray[Any]:
    """Places (N, 2) near the true ones, no two nearer to each other than ``gap`` as far as there is room.

    One after another takes the first free place on a spiral about its own.
    """
    turns = np.arange(_LATTICE * 12)
    reach, angle = 0.25 * gap * np.sqrt(turns), 2.39996 * turns  # the golden angle: the places are spread evenly
    spiral = np.stack((reach * np.cos(angle), reach * np.sin(angle)), axis=1)
    half = gap / 2
    shown = np.empty_like(true)
    for number, place in enumerate(true):
        tried = np.clip(place + spiral, half, np.array(size[:2]) - half)
        away = np.linalg.norm(tried[:, None] - shown[None, :number], axis=2).min(axis=1, initial=np.inf)
        free = np.flatnonzero(away >= gap)
        shown[number] = tried[free[0] if len(free) else int(np.argmax(away))]
    return shown


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


def _ruler(canvas: _Canvas) -> str:
    """A bar of a round length."""
    meters = _nice(0.06 * canvas.size[0] / canvas.scale)
    length = meters * canvas.scale
    x, y = canvas.size[0] - length - 12, 16
    return (
        f'<g class="ruler"><line x1="{x:.1f}" y1="{y}" x2="{x + length:.1f}" y2="{y}"/>'
        f'<text x="{x + length / 2:.1f}" y="{y + 14}">{meters:g} m</text></g>'
    )
