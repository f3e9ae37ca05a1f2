"""Where the scans of a plan stand on the page: floors one above another, and nothing on top of another."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from torchreg.report.page.site_frame import GroupFrame
from torchreg.report.scene import thin
from torchreg.types import Clouds

_WIDTH, _LEAST_HEIGHT, _MOST_HEIGHT = 1040.0, 260.0, 780.0  # of the drawing
_MARGIN = 26.0
_SHADOW_POINTS = 30_000  # of each scan
_TALLER = 1.6  # a drawing of several floors
_ROOM = 2.5  # meters from floor to floor, at least
_MOSTLY, _ABOVE = 0.75, 0.4  # of the scanners stand on floors; of a floor lies above or below the next
_OFTEN = 0.1  # of the scanners stand on a floor
_SPAN = (0.02, 0.98)  # of the points are drawn, and what lies near them
_BEYOND = 0.06
_AROUND, _SEEN = 1.5, 1.3  # extents of the scanners, distances to the middle of the points that are drawn around them
_LATTICE = 720  # places tried along the way out of a crowd


class PlanLayout(NamedTuple):
    """What is drawn of a group, seen along the third axis, and how meters become pixels."""

    floors: NDArray[np.int64]
    """(M,) the number of the floor of each scanner, the lowest 0."""

    scanners: NDArray[Any]
    """(M, 2) pixels."""

    points: NDArray[Any]
    """(N, 2) pixels, points of all scans."""

    corners: NDArray[Any]
    """(F, 2) pixels, the left upper corner of each floor."""

    scale: float
    """Pixels a meter."""

    size: tuple[float, float]
    """Of the drawing, pixels."""


def plan_layout(frame: GroupFrame, scans: Sequence[Clouds], *, below: float = 0.0) -> PlanLayout:
    """Lay out the plan of one group of ``scans``, with so many pixels of room at the bottom."""
    floors = _floors(frame.scanners) if frame.upright else np.zeros(len(frame.members), dtype=np.int64)
    flat, count = _flat(frame, scans, floors), int(floors.max()) + 1
    canvas = _canvas(flat, count, below)
    corners = np.stack((np.full(count, flat.low[0]), flat.high[1] + flat.pitch * np.arange(count)), axis=1)
    at = canvas.at
    return PlanLayout(floors, at(flat.scanners), at(flat.points), at(corners), canvas.scale, canvas.size)


def apart(true: NDArray[Any], gap: float, size: tuple[float, ...]) -> NDArray[Any]:
    """Places (N, 2) near the true ones, no two nearer to each other than ``gap`` as far as there is room.

    One after another takes the first free place on a spiral about its own.
    """
    turns = np.arange(_LATTICE)
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


class _Canvas(NamedTuple):
    low: NDArray[Any]  # (2,) meters, the left lower corner
    scale: float  # pixels a meter
    size: tuple[float, float]

    def at(self, places: NDArray[Any]) -> NDArray[Any]:
        """Pixels (N, 2) of places (N, 2) in meters."""
        flat = (places - self.low) * self.scale
        return np.stack((_MARGIN + flat[:, 0], self.size[1] - _MARGIN - flat[:, 1]), axis=1)


def _floors(scanners: NDArray[Any]) -> NDArray[np.int64]:
    """The number of the floor of each scanner, the lowest 0, from places (M, 3).

    Floors are heights at which many stand, each over or under another; ground that rises has none.
    """
    heights = scanners[:, 2]
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
    away = np.abs(heights[:, None] - np.sort(levels)[None])  # (M, F)
    numbers: NDArray[np.int64] = np.argmin(away, axis=1)
    on_floors = float((away.min(axis=1) < _ROOM / 4).mean()) >= _MOSTLY
    plans = [scanners[numbers == floor, :2] for floor in range(len(levels))]
    above = all(_overlap(one, other) > _ABOVE for one, other in pairwise(plans))
    return numbers if on_floors and above else np.zeros(len(heights), dtype=np.int64)


def _overlap(one: NDArray[Any], other: NDArray[Any]) -> float:
    """The share that two sets of places (N, 2) have in common of their rectangles, along the axis where it is less."""
    low, high = np.maximum(one.min(axis=0), other.min(axis=0)), np.minimum(one.max(axis=0), other.max(axis=0))
    least = np.maximum(np.minimum(np.ptp(one, axis=0), np.ptp(other, axis=0)), _ROOM)
    return float(((high - low + _ROOM) / (least + _ROOM)).min())


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


def _canvas(flat: _Flat, floors: int, below: float) -> _Canvas:
    low, high = flat.low, flat.high + np.array((0.0, flat.pitch * (floors - 1)))
    extent = np.maximum(high - low, 1e-6)
    tallest = _MOST_HEIGHT * (1 if floors == 1 else _TALLER)
    scale = min((_WIDTH - 2 * _MARGIN) / extent[0], (tallest - 2 * _MARGIN) / extent[1])
    height = max(extent[1] * scale + 2 * _MARGIN, _LEAST_HEIGHT)
    spare = np.array((_WIDTH - 2 * _MARGIN - extent[0] * scale, height - 2 * _MARGIN - extent[1] * scale)) / 2 / scale
    return _Canvas(low - spare - np.array((0.0, below / scale)), scale, (_WIDTH, height + below))
