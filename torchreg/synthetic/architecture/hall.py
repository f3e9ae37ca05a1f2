"""The building of a mall: floor, ceiling with a skylight, columns, end walls, and shops along both sides.

The hall lies about the origin, x along it, floor at z = 0. Shop fronts repeat: all bays of a hall have the
same pilasters, fascia and size of sign, as a mall's own rules have it, and all columns are alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.paint import muted, neutral, paint, plain_or_muted, vivid
from torchreg.synthetic.scene.quads import Quads, at_height, boxes, cylinders, rectangles, up


@dataclass(frozen=True, kw_only=True)
class HallPlan:
    """The sizes of a hall, in meters unless stated."""

    length: float  # between the end walls
    width: float  # between the shop fronts
    height: float  # from floor to ceiling
    bays: int  # shop fronts along each side, a count
    opening: float  # height of the shops' openings
    depth: float  # how far shops reach behind their fronts
    sign: float  # height of the sign over each opening
    column_y: float  # distance of both rows of columns from the middle of the hall
    column_size: float  # diameter or edge
    round_columns: bool  # cylinders rather than boxes
    skylight: tuple[float, float]  # length and width of the window in the ceiling
    wall: Array  # (1, 3) sRGB, the color of all fronts

    @property
    def pitch(self) -> float:
        """Length of one bay."""
        return self.length / self.bays

    @property
    def bay_x(self) -> Array:
        """(bays,) the middles of the bays."""
        return self.pitch * (np.arange(self.bays) + 0.5) - self.length / 2

    @property
    def columns(self) -> Array:
        """(N, 2) where the columns stand: at every second border of two bays."""
        x = self.pitch * np.arange(1, self.bays, 2) - self.length / 2
        return np.array([(place, side * self.column_y) for side in (-1, 1) for place in x])

    @property
    def lamps(self) -> Array:
        """(M, 3) where lamps hang from the ceiling: in two rows beside the columns."""
        x = np.linspace(2.5 - self.length / 2, self.length / 2 - 2.5, 6)
        y = (self.column_y + self.width / 2) / 2
        return np.array([(place, side * y, self.height - 0.1) for side in (-1, 1) for place in x])


def draw_plan(rng: np.random.Generator) -> HallPlan:
    """Random sizes of a hall."""
    length, width = rng.uniform(28, 34), rng.uniform(16, 20)
    return HallPlan(
        length=length,
        width=width,
        height=rng.uniform(5.2, 6.8),
        bays=int(rng.integers(6, 8)),
        opening=rng.uniform(2.7, 3.2),
        depth=rng.uniform(2.0, 3.5),
        sign=rng.uniform(0.5, 0.65),
        column_y=width / 2 - rng.uniform(3.2, 4.2),
        column_size=rng.uniform(0.5, 0.8),
        round_columns=bool(rng.random() < 0.5),
        skylight=(length * rng.uniform(0.4, 0.6), rng.uniform(3.0, 5.0)),
        wall=plain_or_muted(rng, 0.3),
    )


def floor(plan: HallPlan, rng: np.random.Generator) -> Quads:
    """Tiles everywhere, a strip of darker ones under each row of columns, colored fields down the middle."""
    length, width = plan.length + 1, plan.width + 2 * plan.depth + 1
    pale, dark = neutral(rng, 0.55, 0.8), neutral(rng, 0.35, 0.55)
    tiles = paint(rng, pale, rng.uniform(0.75, 0.95) * pale, pattern="tiles", scale=rng.uniform(0.45, 0.8))
    strip = paint(rng, dark, 0.8 * dark, count=2, pattern="tiles", scale=rng.uniform(0.3, 0.5))
    count = plan.bays // 2
    field = paint(rng, muted(rng, 2)[np.arange(count) % 2], pattern="tiles", scale=rng.uniform(0.2, 0.4))
    field_at = at_height((np.arange(count) - (count - 1) / 2) * 2 * plan.pitch, 0.0, 0.004)
    strip_at = [(0, -plan.column_y, 0.004), (0, plan.column_y, 0.004)]
    return Quads.join(
        [
            rectangles((0, 0, 0), (length, 0, 0), (0, width, 0), tiles),
            rectangles(strip_at, (plan.length - 0.5, 0, 0), (0, 1.3, 0), strip),
            rectangles(field_at, (rng.uniform(3, 6), 0, 0), (0, rng.uniform(2, 4), 0), field),
        ]
    )


def ceiling(plan: HallPlan, rng: np.random.Generator) -> Quads:
    """Panels or wooden slats around the skylight, its shaft and bars, beams from side to side, lamps."""
    (long, wide), top, lamps = plan.skylight, plan.height, plan.lamps
    rest_x, rest_y = (plan.length + 1 - long) / 2, (plan.width + 1 - wide) / 2
    off_x, off_y = (long + rest_x) / 2, (wide + rest_y) / 2
    white, wooden = neutral(rng, 0.85, 0.95), rng.random() < 0.35
    panels = paint(rng, white, 0.7 * white, count=4, pattern="panels", scale=0.6)
    slats = paint(rng, neutral(rng, 0.5, 0.85) * [1, 0.8, 0.58], count=4, pattern="planks", scale=0.15)
    shaft_at = [(0, -wide / 2, 0.36), (0, wide / 2, 0.36), (-long / 2, 0, 0.36), (long / 2, 0, 0.36)]
    shaft = [(long, 0.1, 0.7), (long, 0.1, 0.7), (0.1, wide, 0.7), (0.1, wide, 0.7)]
    bar_x = np.arange(1.2 - long / 2, long / 2 - 0.3, 1.2)
    beam_x = np.unique(plan.columns[:, 0])
    return Quads.join(
        [
            rectangles(
                [(-off_x, 0, top), (off_x, 0, top), (0, -off_y, top), (0, off_y, top)],
                [(rest_x, 0, 0), (rest_x, 0, 0), (long, 0, 0), (long, 0, 0)],
                [(0, plan.width + 1, 0), (0, plan.width + 1, 0), (0, rest_y, 0), (0, rest_y, 0)],
                slats if wooden else panels,
            ),
            boxes(shaft_at, shaft, paint(rng, white, count=4)).placed(0, 0, top),
            boxes(at_height(bar_x, 0.0, top + 0.6), (0.08, wide, 0.12), paint(rng, (0.45,) * 3, count=len(bar_x))),
            boxes(at_height(beam_x, 0.0, top - 0.2), (0.35, plan.width, 0.42), paint(rng, white, count=len(beam_x))),
            boxes(lamps + up(0.05), (1.2, 0.3, 0.06), paint(rng, (1, 1, 1), count=len(lamps), glow=3.0)),
        ]
    )


def columns(plan: HallPlan, rng: np.random.Generator) -> Quads:
    """Equal columns with a dark foot; some carry a poster towards the middle of the hall."""
    at, size, tall = np.pad(plan.columns, ((0, 0), (0, 1))), plan.column_size, plan.height
    shaft, foot = (paint(rng, tone, count=len(at)) for tone in (plain_or_muted(rng, 0.35), (0.3, 0.3, 0.3)))
    if plan.round_columns:
        parts = [cylinders(at, size / 2, tall, shaft), cylinders(at, size / 2 + 0.03, 0.15, foot)]
    else:
        shaft_size, foot_size = (size, size, tall), (size + 0.06, size + 0.06, 0.15)
        parts = [boxes(at + up(tall / 2), shaft_size, shaft), boxes(at + up(0.075), foot_size, foot)]
    chosen = at[rng.random(len(at)) < 0.35]
    place = chosen - np.sign(chosen) * [0, size / 2 + 0.03, 0] + up(1.6)
    poster = paint(rng, vivid(rng, len(place)), neutral(rng), pattern="poster", scale=0.22)
    return Quads.join([*parts, boxes(place, (0.5, 0.04, 0.9), poster)])


def end_wall(plan: HallPlan, rng: np.random.Generator) -> Quads:
    """A wide wall about its own middle, y behind it: doors under a sign, banners beside them."""
    doors = rng.uniform(-0.2, 0.2) * plan.width
    left, right = doors - rng.uniform(2.8, 3.4), doors + rng.uniform(2.8, 3.4)
    color = plan.wall if rng.random() < 0.5 else muted(rng)
    wall = paint(rng, color, 0.85 * color, pattern="panels", scale=1.2)
    door_at = [(doors - 0.8, -0.08, 1.15), (doors + 0.8, -0.08, 1.15)]
    sign = paint(rng, vivid(rng), (1, 1, 1), pattern="letters", scale=0.35)
    banner = paint(rng, vivid(rng, 2), neutral(rng), pattern="poster", scale=0.5)
    tall = plan.height
    return Quads.join(
        [
            boxes((0, 0.2, tall / 2), (plan.width + 1, 0.4, tall), wall),
            boxes((doors, -0.04, 1.2), (3.4, 0.1, 2.4), paint(rng, (0.35, 0.35, 0.35))),
            boxes(door_at, (1.5, 0.06, 2.2), paint(rng, (0.12,) * 3, count=2)),
            boxes((doors, -0.05, 2.8), (3.4, 0.08, 0.5), sign),
            boxes([(left, -0.03, tall / 2), (right, -0.03, tall / 2)], (1.2, 0.04, tall / 2), banner),
        ]
    )
