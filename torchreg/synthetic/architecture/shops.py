"""One shop front and what is behind it: an open shop, a shutter, or a closed wall with posters.

A bay is built about the middle of its front, on the floor, x along the front, y into the shop. Pieces with
a front face -y.
"""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.architecture.hall import HallPlan
from torchreg.synthetic.furniture.indoor import shelf
from torchreg.synthetic.scene.paint import muted, neutral, paint, plain_or_muted, vivid, wares
from torchreg.synthetic.scene.quads import Quads, at_height, boxes, rectangles


def bay(plan: HallPlan, rng: np.random.Generator) -> Quads:
    """A shop front with its pilasters, fascia and sign, and the room behind."""
    parts = [_front(plan, rng), _room(plan, rng)]
    kind = rng.random()
    if kind < 0.65:
        width = plan.pitch - 1.0
        back = shelf(rng, width) if rng.random() < 0.6 else clothes_rail(rng, width)
        first = counter(rng, 0.5 * width) if rng.random() < 0.5 else table(rng)
        parts.append(back.placed(0, plan.depth - 0.35))
        parts.append(first.placed(0.2 * width * rng.uniform(-1, 1), 0.45 * plan.depth))
    else:
        parts.append(_shutter(plan, rng) if kind < 0.8 else _closed(plan, rng))
    return Quads.join(parts)


def clothes_rail(rng: np.random.Generator, width: float) -> Quads:
    """Garments on two rails, one above the other."""
    per_rail = int(width / 0.07)
    x = np.tile((np.arange(per_rail) + 0.5) * width / per_rail - width / 2, 2)
    top, count = np.repeat([1.95, 0.98], per_rail), 2 * per_rail
    size = rng.uniform((0.04, 0.35, 0.55), (0.05, 0.5, 0.85), (count, 3))
    center = np.stack((x, rng.uniform(-0.03, 0.03, count), top - size[:, 2] / 2), axis=1)
    colors = wares(rng, count)[np.arange(count) // int(rng.integers(3, 9))]
    there = rng.random(count) < 0.8
    turned = rng.uniform(-0.2, 0.2, count)
    return Quads.join(
        [
            boxes([(0, 0, 1.98), (0, 0, 1.01)], (width, 0.03, 0.03), paint(rng, (0.6, 0.6, 0.6), count=2)),
            boxes(center[there], size[there], paint(rng, colors[there]), yaw=turned[there]),
        ]
    )


def counter(rng: np.random.Generator, width: float) -> Quads:
    """A till: a box with a wooden top, a screen and small goods."""
    body = neutral(rng, 0.4, 0.9) if rng.random() < 0.6 else 0.8 * vivid(rng)
    goods = paint(rng, vivid(rng), pattern="goods", scale=0.08)
    top = paint(rng, (0.6, 0.45, 0.3), pattern="planks", scale=0.1)
    return Quads.join(
        [
            boxes((0, 0, 0.5), (width, 0.6, 1.0), paint(rng, body, pattern="planks", scale=0.3)),
            boxes((0, 0, 1.02), (width + 0.1, 0.7, 0.04), top),
            boxes((0.2 * width, 0, 1.25), (0.4, 0.05, 0.3), paint(rng, (0.12, 0.12, 0.12))),
            boxes((-0.25 * width, 0, 1.14), (0.5, 0.3, 0.2), goods),
        ]
    )


def table(rng: np.random.Generator) -> Quads:
    """A low table with folded wares in stacks."""
    grid = np.stack(np.meshgrid([-0.6, -0.2, 0.2, 0.6], [-0.2, 0.2]), axis=-1).reshape(-1, 2)
    tall = rng.uniform(0.05, 0.3, len(grid))
    size = np.stack((0 * tall + 0.3, 0 * tall + 0.26, tall), axis=1)
    stacks = paint(rng, wares(rng, len(grid)), pattern="stripes", scale=0.04)
    top = neutral(rng, 0.6, 0.95)
    return Quads.join(
        [
            boxes((0, 0, 0.72), (1.7, 0.9, 0.06), paint(rng, top)),
            boxes([(-0.75, 0, 0.35), (0.75, 0, 0.35)], (0.06, 0.8, 0.7), paint(rng, top, count=2)),
            boxes(np.column_stack((grid, 0.75 + tall / 2)), size, stacks),
        ]
    )


def _front(plan: HallPlan, rng: np.random.Generator) -> Quads:
    pitch, opening, tall, sign = plan.pitch, plan.opening, plan.height, plan.sign
    over = opening + 0.25 + sign / 2
    at = pitch / 2 - 0.126  # neighboring bays share no face
    wall = paint(rng, plan.wall, 0.85 * plan.wall, count=2, pattern="panels", scale=1.2)
    ground, letters = (vivid(rng), neutral(rng)) if rng.random() < 0.6 else (neutral(rng), vivid(rng))
    glow = 0.5 if rng.random() < 0.5 else 0.0
    tone = muted(rng) if rng.random() < 0.6 else 0.9 * plan.wall
    portal = paint(rng, tone, 0.85 * tone, pattern="panels", scale=1.2)
    board = paint(rng, ground, letters, pattern="letters", scale=0.6 * sign, glow=glow)
    return Quads.join(
        [
            boxes([(-at, 0.17, tall / 2), (at, 0.17, tall / 2)], (0.25, 0.44, tall), wall),
            boxes((0, 0.2, (opening + tall) / 2), (pitch - 0.3, 0.4, tall - opening), wall.take(np.array([0]))),
            boxes((0, -0.02, over), (pitch - 0.5, 0.06, sign + 0.5), portal),
            boxes((0, -0.1, over), (0.72 * pitch, 0.12, sign), board),
        ]
    )


def _room(plan: HallPlan, rng: np.random.Generator) -> Quads:
    """Back, sides, a ceiling, a floor of wood or carpet; the walls are often colored."""
    pitch, depth, tall = plan.pitch, plan.depth, plan.opening + 0.1
    back = plain_or_muted(rng, 0.6)
    sides = back if rng.random() < 0.5 else neutral(rng, 0.8, 0.95)
    walls = np.concatenate((back, sides, sides, neutral(rng, 0.85, 0.95)))
    side, half_depth, half_tall = pitch / 2 - 0.02, depth / 2, tall / 2
    middles = [(0, depth, half_tall), (-side, half_depth, half_tall), (side, half_depth, half_tall)]
    middles.append((0, half_depth, tall))
    wood = paint(rng, neutral(rng, 0.4, 0.8) * [1, 0.85, 0.65], pattern="planks", scale=0.14)
    ground = wood if rng.random() < 0.6 else paint(rng, muted(rng))
    return Quads.join(
        [
            rectangles(
                middles,
                [(-pitch, 0, 0), (0, -depth, 0), (0, depth, 0), (pitch, 0, 0)],
                [(0, 0, tall), (0, 0, tall), (0, 0, tall), (0, depth, 0)],
                paint(rng, walls),
            ),
            rectangles((0, half_depth, 0.008), (pitch, 0, 0), (0, depth, 0), ground),
        ]
    )


def _shutter(plan: HallPlan, rng: np.random.Generator) -> Quads:
    gray = neutral(rng, 0.5, 0.75)
    slats = paint(rng, gray, 0.85 * gray, pattern="stripes", scale=0.06)
    return boxes((0, 0.3, plan.opening / 2), (plan.pitch - 0.3, 0.05, plan.opening), slats)


def _closed(plan: HallPlan, rng: np.random.Generator) -> Quads:
    count = int(rng.integers(0, 4))
    x = (np.arange(count) - (count - 1) / 2) * 1.3
    posters = paint(rng, vivid(rng, count), neutral(rng), pattern="poster", scale=0.25)
    color = plan.wall if rng.random() < 0.5 else muted(rng)
    wall = boxes((0, 0.2, plan.opening / 2), (plan.pitch - 0.3, 0.1, plan.opening), paint(rng, color))
    return Quads.join([wall, boxes(at_height(x, 0.13, 1.6), (0.84, 0.03, 1.19), posters)])
