"""Houses of two to four floors: windows set back between piers, balconies, a door under a canopy, a roof.

A house is made about the middle of the foot of its front, x along the front, which faces -y, z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.paint import Paint, from_hsv, muted, neutral, paint, plain_or_muted, vivid
from torchreg.synthetic.scene.quads import Quads, boxes, cylinders, prism, rectangles

_RECESS = 0.22  # meters that the panes lie behind the front


@dataclass(frozen=True, kw_only=True)
class _Front:
    """Sizes of a front, in meters unless stated; floors and columns of windows are counts."""

    length: float
    floors: int
    floor: float
    columns: int
    window: tuple[float, float]
    sill: float

    @property
    def height(self) -> float:
        return self.floors * self.floor + 0.4

    @property
    def x(self) -> Array:
        """(columns,) the middles of the windows."""
        return (np.arange(self.columns) - (self.columns - 1) / 2) * self.length / self.columns

    @property
    def sills(self) -> Array:
        """(floors,) the heights of the lower edges of the windows."""
        return np.arange(self.floors) * self.floor + self.sill

    @property
    def windows(self) -> Array:
        """(floors * columns, 3) the middles of the windows in the plane of the front, by floor from below."""
        return np.array([(x, 0, height) for height in self.sills + self.window[1] / 2 for x in self.x])


def house(rng: np.random.Generator, length: float, depth: float) -> Quads:
    """A house of this length along its front and this depth, meters."""
    floor = rng.uniform(3.0, 3.6)
    columns = int(length / rng.uniform(2.4, 3.6))
    front = _Front(
        length=length,
        floors=int(rng.integers(2, 5)),
        floor=floor,
        columns=columns,
        window=(rng.uniform(0.45, 0.72) * length / columns, rng.uniform(0.42, 0.6) * floor),
        sill=rng.uniform(0.7, 1.0),
    )
    wall = _wall_paint(rng)
    door = int(rng.integers(columns))
    parts = [_wall(front, wall), _body(front, depth, rng), _roof(front, depth, rng)]
    parts += [_windows(front, rng), _entrance(front.x[door], rng), _pipes(front, rng)]
    if rng.random() < 0.45:
        parts.append(_balconies(front, rng))
    if rng.random() < 0.5:
        ground, letters = (vivid(rng), neutral(rng)) if rng.random() < 0.5 else (neutral(rng), vivid(rng))
        board = paint(rng, ground, letters, pattern="letters", scale=0.5)
        parts.append(boxes((0.2 * length * rng.uniform(-1, 1), -0.06, floor), (0.25 * length, 0.1, 0.6), board))
    return Quads.join(parts)


def _wall_paint(rng: np.random.Generator) -> Paint:
    """Bricks, plaster or panels."""
    kind = rng.random()
    if kind < 0.35:
        brick = from_hsv(rng.uniform(0.01, 0.07, 1), rng.uniform(0.4, 0.65, 1), rng.uniform(0.45, 0.65, 1))
        return paint(rng, brick, 0.5 * brick + 0.5 * neutral(rng, 0.6, 0.75), pattern="bricks", scale=0.09)
    color = plain_or_muted(rng, 0.6)
    return paint(rng, color, 0.8 * color, pattern="plain" if kind < 0.7 else "panels", scale=1.4)


def _wall(front: _Front, paint: Paint) -> Quads:
    """Bands under and over the windows, and the piers between them."""
    (wide, tall), thick, low = front.window, _RECESS + 0.1, front.sills
    below, above = np.concatenate(([0.0], low + tall)), np.concatenate((low, [front.height]))
    bands = np.column_stack((0 * below, 0 * below + thick / 2, (below + above) / 2))
    band_size = np.column_stack((0 * below + front.length, 0 * below + thick, above - below))
    pitch = front.length / front.columns
    x = np.concatenate(([front.x[0] - pitch], front.x)) + pitch / 2
    outer = np.isin(np.arange(len(x)), (0, len(x) - 1))
    pier = np.where(outer, (pitch - wide) / 2, pitch - wide)
    x = x + np.where(outer, -np.sign(x) * pier / 2, 0)
    piers = np.array([(place, thick / 2, z + tall / 2) for z in low for place in x])
    pier_size = np.column_stack((np.tile(pier, len(low)), np.full(len(piers), thick), np.full(len(piers), tall)))
    parts = ((bands, band_size), (piers, pier_size))
    return Quads.join([boxes(at, size, paint.take(np.zeros(len(at), dtype=np.int64))) for at, size in parts])


def _windows(front: _Front, rng: np.random.Generator) -> Quads:
    """Dark panes, some behind a blind or a curtain, each with a frame in the middle and a ledge."""
    at, (wide, tall) = front.windows, front.window
    count = len(at)
    sky, curtain = from_hsv(*rng.uniform((0.5, 0.1, 0.12), (0.65, 0.4, 0.35), (count, 3)).T), neutral(rng, 0.6, 0.95)
    shade = vivid(rng) if rng.random() < 0.6 else muted(rng)
    kind = rng.random((count, 1))
    color = np.where(kind < 0.62, sky, np.where(kind < 0.82, curtain, np.where(kind < 0.95, shade, vivid(rng, count))))
    panes = rectangles(at + np.array([0, _RECESS, 0]), (wide, 0, 0), (0, 0, tall), paint(rng, color))
    frame_tone = neutral(rng, 0.75, 0.95) if rng.random() < 0.6 else muted(rng)
    frame, ledge = paint(rng, frame_tone, count=count), paint(rng, neutral(rng, 0.5, 0.8), count=count)
    lowered = at[kind[:, 0] > 0.9]
    blind = paint(rng, shade, 0.8 * shade, count=len(lowered), pattern="stripes", scale=0.08)
    return Quads.join(
        [
            panes,
            boxes(at + np.array([0, _RECESS - 0.03, 0]), (0.08, 0.06, tall), frame),
            boxes(at + np.array([0, _RECESS - 0.03, 0.2 * tall]), (wide, 0.06, 0.08), frame),
            boxes(at + np.array([0, -0.04, -0.02 - tall / 2]), (wide + 0.14, 0.16, 0.05), ledge),
            boxes(lowered + np.array([0, 0.1, 0.3 * tall]), (wide, 0.03, 0.4 * tall), blind),
        ]
    )


def _balconies(front: _Front, rng: np.random.Generator) -> Quads:
    """At every second window of the upper floors, with a colored parapet."""
    chosen = (np.arange(front.floors * front.columns) // front.columns > 0) & (
        np.arange(front.floors * front.columns) % front.columns % 2 == int(rng.integers(2))
    )
    at = front.windows[chosen]
    at[:, 2] = np.floor(at[:, 2] / front.floor) * front.floor
    wide, deep = 0.85 * front.length / front.columns, rng.uniform(0.9, 1.4)
    slab = paint(rng, neutral(rng, 0.5, 0.8), count=len(at))
    color = vivid(rng) if rng.random() < 0.4 else plain_or_muted(rng, 0.6)
    rail = paint(rng, color, 0.85 * color, count=len(at), pattern="stripes", scale=0.12)
    sides = [boxes(at + np.array([s * wide / 2, -deep / 2, 0.55]), (0.05, deep, 0.9), rail) for s in (-1, 1)]
    return Quads.join(
        [
            boxes(at + np.array([0, -deep / 2, 0.05]), (wide + 0.1, deep, 0.16), slab),
            boxes(at + np.array([0, -deep, 0.55]), (wide, 0.05, 0.9), rail),
            *sides,
        ]
    )


def _entrance(x: float, rng: np.random.Generator) -> Quads:
    """A porch in front of one column of windows: a door in a surround, under a canopy, two steps before it."""
    wide, stone = rng.uniform(1.6, 2.4), paint(rng, neutral(rng, 0.45, 0.75), count=2)
    color = vivid(rng) if rng.random() < 0.5 else muted(rng)
    surround = paint(rng, plain_or_muted(rng, 0.4))
    return Quads.join(
        [
            boxes((x, -0.08, 1.45), (wide + 0.6, 0.2, 2.9), surround),
            boxes((x, -0.2, 1.4), (wide, 0.06, 2.2), paint(rng, color, 0.8 * color, pattern="panels", scale=wide / 2)),
            boxes((x, -0.75, 2.85), (wide + 0.8, 1.5, 0.16), paint(rng, neutral(rng, 0.4, 0.9))),
            boxes([(x, -0.5, 0.1), (x, -0.7, 0.1)], [(wide + 0.6, 0.9, 0.4), (wide + 1.0, 1.3, 0.2)], stone),
        ]
    )


def _pipes(front: _Front, rng: np.random.Generator) -> Quads:
    """Rain pipes near both corners."""
    x = front.length / 2 - 0.15
    tone = (0.35, 0.36, 0.37) if rng.random() < 0.5 else (0.55, 0.36, 0.25)
    return cylinders([(-x, -0.08, 0), (x, -0.08, 0)], 0.06, front.height, paint(rng, tone, count=2), sides=10)


def _body(front: _Front, depth: float, rng: np.random.Generator) -> Quads:
    """The body behind the front, with a few windows in both of its ends."""
    color, inside = plain_or_muted(rng, 0.5), _RECESS + 0.02
    box = boxes(
        (0, inside + (depth - inside) / 2, front.height / 2),
        (front.length - 0.02, depth - inside, front.height),
        paint(rng, color, 0.85 * color, pattern="panels", scale=2.0),
    )
    z = front.sills + front.window[1] / 2
    places = np.array([(s * front.length / 2, t * depth, height) for height in z for s in (-1, 1) for t in (0.3, 0.7)])
    dark = from_hsv(*rng.uniform((0.5, 0.1, 0.12), (0.65, 0.4, 0.35), (len(places), 3)).T)
    return Quads.join([box, boxes(places, (0.06, 1.1, front.window[1]), paint(rng, dark))])


def _roof(front: _Front, depth: float, rng: np.random.Generator) -> Quads:
    """Flat behind a parapet, or a gable with its ridge along the front."""
    if rng.random() < 0.5:
        slab = paint(rng, neutral(rng, 0.35, 0.8))
        return boxes((0, depth / 2, front.height + 0.15), (front.length + 0.4, depth + 0.4, 0.5), slab)
    tile = from_hsv(rng.uniform(0.0, 0.06, 1), rng.uniform(0.15, 0.6, 1), rng.uniform(0.3, 0.55, 1))
    half, rise = depth / 2 + 0.5, depth / 2 * math.tan(math.radians(rng.uniform(25, 42)))
    gable = prism(
        [(-half, 0), (half, 0), (half, 0.2), (0, rise), (-half, 0.2)],
        front.length + 0.6,
        paint(rng, tile, 0.8 * tile, pattern="panels", scale=0.35),
    )
    return gable.placed(0, depth / 2, front.height, yaw=math.pi / 2)
