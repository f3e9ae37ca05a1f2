"""Furniture of halls, and people: kiosks, benches, planters, boards, bins, cartons, shelves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from torchreg.synthetic.scene.paint import from_hsv, neutral, paint, vivid, wares
from torchreg.synthetic.scene.quads import Quads, balls, boxes, cylinders, rectangles, up


def kiosk(rng: np.random.Generator) -> Quads:
    """A stand with counters around it and a sign on all sides of its roof."""
    edge = rng.uniform(2.0, 2.6)
    body, sign = neutral(rng, 0.5, 0.9), vivid(rng)
    beside = edge / 2 * np.array([(0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0)])
    size = np.array([(edge + 0.5, 0.5, 1.05)] * 2 + [(0.5, edge - 0.5, 1.05)] * 2)
    posts = (edge / 2 + 0.1) * np.array([(-1, -1, 0), (-1, 1, 0), (1, -1, 0), (1, 1, 0)]) + up(1.2)
    goods = paint(rng, vivid(rng, 4), pattern="goods", scale=rng.uniform(0.1, 0.2))
    roof = paint(rng, sign, (1, 1, 1), pattern="letters", scale=0.3)
    return Quads.join(
        [
            boxes(beside + up(0.525), size, paint(rng, body, sign, count=4, pattern="stripes", scale=0.35)),
            boxes(beside + up(1.2), size * [0.6, 0.6, 0.27], goods),
            boxes(posts, (0.08, 0.08, 2.4), paint(rng, (0.5, 0.5, 0.5), count=4)),
            boxes((0, 0, 2.6), (edge + 0.6, edge + 0.6, 0.45), roof),
            boxes((0, 0, 1.0), (0.5, 0.5, 2.0), paint(rng, body)),
        ]
    )


def bench(rng: np.random.Generator) -> Quads:
    """A wooden seat on two blocks."""
    wood = paint(rng, np.array([0.62, 0.45, 0.28]) * rng.uniform(0.7, 1.2), pattern="planks", scale=0.11)
    legs = paint(rng, neutral(rng, 0.3, 0.7), count=2)
    return Quads.join(
        [
            boxes((0, 0, 0.45), (1.8, 0.5, 0.07), wood),
            boxes([(-0.65, 0, 0.2), (0.65, 0, 0.2)], (0.12, 0.45, 0.4), legs),
        ]
    )


def planter(rng: np.random.Generator) -> Quads:
    """A pot, a trunk and a few hundred leaves."""
    tall, crown, count = rng.uniform(0.4, 0.7), rng.uniform(0.35, 0.6), 350
    pot = paint(rng, neutral(rng, 0.35, 0.9))
    outward = rng.standard_normal((count, 3))
    outward *= crown * rng.random((count, 1)) ** 0.4 / np.linalg.norm(outward, axis=1, keepdims=True)
    edge_u, edge_v = 0.06 * rng.standard_normal((2, count, 3))
    green = from_hsv(*rng.uniform((0.24, 0.5, 0.2), (0.36, 0.8, 0.6), (count, 3)).T)
    rounded, boxed = cylinders((0, 0, 0), 0.35, tall, pot), boxes((0, 0, tall / 2), (0.7, 0.7, tall), pot)
    return Quads.join(
        [
            rounded if rng.random() < 0.5 else boxed,
            cylinders((0, 0, tall), 0.04, 0.5, paint(rng, (0.35, 0.25, 0.15)), sides=8),
            rectangles(outward + up(tall + 0.4 + crown), edge_u, edge_v, paint(rng, green)),
        ]
    )


def board(rng: np.random.Generator) -> Quads:
    """An upright board with a poster on each side."""
    poster = paint(rng, vivid(rng), neutral(rng), pattern="poster", scale=0.25)
    return Quads.join(
        [
            boxes((0, 0, 1.15), (0.8, 0.16, 1.7), poster),
            boxes((0, 0, 0.15), (0.9, 0.4, 0.3), paint(rng, (0.4, 0.4, 0.4))),
        ]
    )


def litter_bin(rng: np.random.Generator) -> Quads:
    """A steel cylinder with a colored ring."""
    return Quads.join(
        [
            cylinders((0, 0, 0), 0.22, 0.85, paint(rng, (0.55, 0.55, 0.55)), sides=20),
            cylinders((0, 0, 0.62), 0.23, 0.12, paint(rng, vivid(rng)), sides=20),
        ]
    )


def cartons(rng: np.random.Generator) -> Quads:
    """A stack of one to three boxes: cardboard, or crates of one color."""
    count = int(rng.integers(1, 4))
    size = rng.uniform(0.3, 0.55, (count, 3))
    middle = np.cumsum(size[:, 2]) - size[:, 2] / 2
    center = np.column_stack((0.04 * rng.standard_normal((count, 2)), middle))
    color = np.array([[0.66, 0.5, 0.34]]) if rng.random() < 0.6 else vivid(rng)
    color = rng.uniform(0.85, 1.05, (count, 1)) * color
    card = paint(rng, color, (0.9, 0.9, 0.9), pattern="letters", scale=0.1)
    return boxes(center, size, card, yaw=rng.uniform(-0.4, 0.4, count))


def shelf(rng: np.random.Generator, width: float) -> Quads:
    """A wall unit of boards with goods, side by side in groups of one color."""
    levels, per_level = 5, int(width / 0.16)
    boards = 0.1 + 0.42 * np.arange(levels)
    level, slot = np.repeat(np.arange(levels), per_level), np.tile(np.arange(per_level), levels)
    size = rng.uniform((0.08, 0.12, 0.12), (0.15, 0.3, 0.34), (len(slot), 3))
    x = (slot + 0.5) * width / per_level - width / 2
    center = np.stack((x, 0.1 - size[:, 1] / 2, boards[level] + 0.015 + size[:, 2] / 2), axis=1)
    group = (slot + 3 * level) // int(rng.integers(3, 7)) + level
    colors = wares(rng, group.max() + 1)[group]
    there = rng.random(len(slot)) < 0.85
    frame = neutral(rng, 0.5, 0.9)
    board_at = np.stack((0 * boards, 0 * boards - 0.02, boards), axis=1)
    return Quads.join(
        [
            boxes(board_at, (width, 0.4, 0.03), paint(rng, frame, count=levels)),
            boxes((0, 0.2, 1.05), (width, 0.03, 2.1), paint(rng, frame)),
            boxes(center[there], size[there], paint(rng, colors[there])),
        ]
    )


def person(rng: np.random.Generator) -> Quads:
    """A standing person of rounded parts."""
    trousers = neutral(rng, 0.1, 0.5)
    shirt = neutral(rng, 0.2, 0.9) if rng.random() < 0.5 else vivid(rng)
    skin = from_hsv(np.array([0.07]), rng.uniform(0.3, 0.6, 1), rng.uniform(0.4, 0.9, 1))
    legs, arms = [(0.1, 0, 0), (-0.1, 0.1, 0)], [(0.25, 0, 0.8), (-0.25, 0, 0.8)]
    quads = Quads.join(
        [
            cylinders(legs, 0.08, 0.85, paint(rng, trousers, count=2), sides=12),
            cylinders(arms, 0.05, 0.6, paint(rng, shirt, count=2), sides=12),
            balls((0, 0, 1.15), (0.22, 0.14, 0.36), paint(rng, shirt)),
            balls((0, 0, 0.9), (0.19, 0.14, 0.2), paint(rng, trousers)),
            balls((0, 0, 1.62), (0.09, 0.11, 0.13), paint(rng, skin)),
        ]
    )
    return replace(quads, corners=quads.corners * rng.uniform(0.9, 1.08))
