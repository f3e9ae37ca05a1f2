"""Furniture of offices. Pieces stand on the floor; they face -y, and what leans on a wall has it at y = 0."""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.scene.paint import muted, neutral, paint, vivid, wares
from torchreg.synthetic.scene.quads import Quads, balls, boxes, cylinders, up


def desk(rng: np.random.Generator) -> Quads:
    """A desk to sit at from -y, with a screen or two, papers and a drawer unit."""
    top, metal = neutral(rng, 0.55, 0.95), neutral(rng, 0.3, 0.8)
    wood = paint(rng, top * [1, 0.85, 0.65] if rng.random() < 0.5 else top, pattern="planks", scale=0.2)
    screens = 1 + int(rng.random() < 0.5)
    x = (np.arange(screens) - (screens - 1) / 2) * 0.58 + rng.uniform(-0.15, 0.15)
    screen_at = np.stack((x, 0 * x + 0.2, 0 * x + 1.05), axis=1)
    heaps = int(rng.integers(2, 6))
    heap = np.column_stack((rng.uniform((-0.7, -0.3), (0.7, 0.3), (heaps, 2)), np.full(heaps, 0.78)))
    heap_size = rng.uniform((0.1, 0.15, 0.03), (0.25, 0.3, 0.16), (heaps, 3))
    return Quads.join(
        [
            boxes((0, 0, 0.72), (1.6, 0.8, 0.04), wood),
            boxes([(-0.75, 0, 0.35), (0.75, 0, 0.35)], (0.06, 0.7, 0.7), paint(rng, metal, count=2)),
            boxes((0.5, 0.05, 0.32), (0.4, 0.6, 0.6), paint(rng, neutral(rng, 0.4, 0.9))),
            boxes(screen_at, (0.54, 0.05, 0.34), paint(rng, (0.1, 0.1, 0.11), count=screens)),
            boxes(screen_at - up(0.22), (0.06, 0.06, 0.14), paint(rng, (0.2, 0.2, 0.2), count=screens)),
            boxes((x[0], -0.15, 0.755), (0.44, 0.14, 0.02), paint(rng, (0.15, 0.15, 0.15))),
            boxes(heap, heap_size, paint(rng, wares(rng, heaps)), yaw=rng.uniform(-0.4, 0.4, heaps)),
        ]
    )


def swivel_chair(rng: np.random.Generator) -> Quads:
    """A chair on five feet; whoever sits on it looks to -y."""
    cloth = neutral(rng, 0.08, 0.4) if rng.random() < 0.6 else 0.8 * vivid(rng)
    dark = (0.12, 0.12, 0.12)
    turn = 2 * np.pi * np.arange(5) / 5
    feet = 0.16 * np.stack((np.cos(turn), np.sin(turn), 0 * turn + 0.4), axis=1)
    return Quads.join(
        [
            boxes((0, 0, 0.46), (0.48, 0.46, 0.08), paint(rng, cloth)),
            boxes((0, 0.24, 0.8), (0.44, 0.06, 0.52), paint(rng, cloth)),
            cylinders((0, 0, 0.08), 0.03, 0.36, paint(rng, dark), sides=8),
            boxes(feet, (0.32, 0.05, 0.05), paint(rng, dark, count=5), yaw=turn),
        ]
    )


def plain_chair(rng: np.random.Generator) -> Quads:
    """A chair on four legs; whoever sits on it looks to -y."""
    seat = neutral(rng, 0.1, 0.9) if rng.random() < 0.5 else vivid(rng)
    legs = 0.2 * np.array([(-1, -1, 1.1), (-1, 1, 1.1), (1, -1, 1.1), (1, 1, 1.1)])
    return Quads.join(
        [
            boxes((0, 0, 0.45), (0.45, 0.45, 0.04), paint(rng, seat)),
            boxes((0, 0.22, 0.7), (0.43, 0.03, 0.35), paint(rng, seat)),
            boxes(legs, (0.03, 0.03, 0.44), paint(rng, (0.4, 0.4, 0.4), count=4)),
        ]
    )


def long_table(rng: np.random.Generator, length: float, width: float = 1.1) -> Quads:
    """A table along x with cups, papers and a telephone on it."""
    top, count = neutral(rng, 0.35, 0.9) * [1, 0.88, 0.7], int(3 * length)
    place = np.column_stack(
        (rng.uniform((-0.45 * length, -0.4 * width), (0.45 * length, 0.4 * width), (count, 2)), np.full(count, 0.77))
    )
    size = rng.uniform((0.06, 0.06, 0.03), (0.25, 0.2, 0.14), (count, 3))
    feet = [(-0.35 * length, 0, 0.35), (0.35 * length, 0, 0.35)]
    return Quads.join(
        [
            boxes((0, 0, 0.72), (length, width, 0.05), paint(rng, top, pattern="planks", scale=0.25)),
            boxes(feet, (0.12, 0.6 * width, 0.7), paint(rng, neutral(rng, 0.2, 0.7), count=2)),
            boxes(place, size, paint(rng, wares(rng, count))),
        ]
    )


def cabinet(rng: np.random.Generator) -> Quads:
    """A cupboard with doors, and boxes on it."""
    width, tall = rng.uniform(0.8, 1.3), rng.uniform(0.9, 1.9)
    front = neutral(rng, 0.5, 0.95) if rng.random() < 0.6 else muted(rng)
    count = int(rng.integers(0, 4))
    x, size = rng.uniform(-0.35, 0.35, count) * width, rng.uniform((0.15, 0.15, 0.1), (0.3, 0.3, 0.35), (count, 3))
    on_top = np.stack((x, np.full(count, -0.22), tall + size[:, 2] / 2), axis=1)
    return Quads.join(
        [
            boxes((0, -0.22, tall / 2), (width, 0.42, tall), paint(rng, front, pattern="panels", scale=width / 2)),
            boxes(on_top, size, paint(rng, wares(rng, count))),
        ]
    )


def whiteboard(rng: np.random.Generator) -> Quads:
    """A white board on the wall with writing and notes on it."""
    width, notes = rng.uniform(1.4, 2.2), int(rng.integers(3, 12))
    x, z = rng.uniform(-0.45, 0.45, notes) * width, rng.uniform(1.1, 1.95, notes)
    place = np.stack((x, np.full(notes, -0.05), z), axis=1)
    written = paint(rng, (0.93, 0.93, 0.93), 0.6 * vivid(rng), pattern="letters", scale=0.5)
    return Quads.join(
        [
            boxes((0, -0.02, 1.5), (width, 0.03, 1.1), written),
            boxes(place, (0.14, 0.01, 0.12), paint(rng, vivid(rng, notes))),
            boxes((0, -0.06, 0.94), (width, 0.08, 0.03), paint(rng, (0.6, 0.6, 0.6))),
        ]
    )


def picture(rng: np.random.Generator) -> Quads:
    """A framed poster on the wall."""
    width, tall = rng.uniform(0.5, 1.2), rng.uniform(0.6, 1.1)
    image = paint(rng, vivid(rng), neutral(rng), pattern="poster", scale=rng.uniform(0.12, 0.3))
    at = (rng.uniform(-0.2, 0.2), -0.02, rng.uniform(1.4, 1.7))
    return boxes(at, (width, 0.04, tall), image)


def notice_board(rng: np.random.Generator) -> Quads:
    """A board of cork or cloth on the wall, with sheets of paper."""
    width, sheets = rng.uniform(1.0, 2.0), int(rng.integers(5, 16))
    x, z = rng.uniform(-0.45, 0.45, sheets) * width, rng.uniform(1.15, 1.85, sheets)
    place = np.stack((x, -0.045 - 0.002 * np.arange(sheets), z), axis=1)
    size = rng.uniform((0.15, 0.005, 0.2), (0.3, 0.01, 0.3), (sheets, 3))
    paper = paint(rng, wares(rng, sheets), (0.2, 0.2, 0.2), pattern="letters", scale=0.08)
    return Quads.join([boxes((0, -0.02, 1.5), (width, 0.03, 0.9), paint(rng, muted(rng))), boxes(place, size, paper)])


def sofa(rng: np.random.Generator) -> Quads:
    """A sofa with arms and cushions."""
    width, cloth = rng.uniform(1.4, 2.0), muted(rng)
    arms = [(-width / 2, -0.4, 0.3), (width / 2, -0.4, 0.3)]
    cushions = np.column_stack((rng.uniform(-0.4, 0.4, 2) * width, (-0.3, -0.3), (0.55, 0.55)))
    return Quads.join(
        [
            boxes((0, -0.4, 0.22), (width, 0.75, 0.4), paint(rng, cloth)),
            boxes((0, -0.1, 0.5), (width, 0.2, 0.5), paint(rng, cloth)),
            boxes(arms, (0.18, 0.78, 0.6), paint(rng, cloth, count=2)),
            balls(cushions, (0.22, 0.1, 0.18), paint(rng, vivid(rng, 2)), sides=10),
        ]
    )


def kitchen_unit(rng: np.random.Generator, width: float) -> Quads:
    """Cupboards below and above a worktop, with appliances, and a refrigerator at the end."""
    doors, count = neutral(rng, 0.5, 0.95) if rng.random() < 0.5 else muted(rng), int(3 * width)
    x = rng.uniform(-0.5, 0.3, count) * width
    size = rng.uniform((0.1, 0.1, 0.1), (0.3, 0.3, 0.4), (count, 3))
    things = np.stack((x, np.full(count, -0.3), 0.92 + size[:, 2] / 2), axis=1)
    stone = paint(rng, neutral(rng, 0.2, 0.8), pattern="patches", scale=0.1)
    front = paint(rng, doors, count=2, pattern="panels", scale=0.5)
    return Quads.join(
        [
            boxes(
                [(-0.35, -0.3, 0.44), (-0.35, -0.18, 1.85)], [(width - 0.7, 0.6, 0.86), (width - 0.7, 0.35, 0.7)], front
            ),
            boxes((-0.35, -0.31, 0.9), (width - 0.7, 0.64, 0.04), stone),
            boxes((width / 2 - 0.35, -0.32, 0.9), (0.62, 0.62, 1.8), paint(rng, neutral(rng, 0.6, 0.95))),
            boxes(things, size, paint(rng, wares(rng, count))),
        ]
    )


def copier(rng: np.random.Generator) -> Quads:
    """A copying machine with a stack of paper."""
    return Quads.join(
        [
            boxes((0, -0.35, 0.5), (0.6, 0.6, 0.95), paint(rng, neutral(rng, 0.5, 0.9), pattern="panels", scale=0.3)),
            boxes((0, -0.35, 1.05), (0.58, 0.5, 0.14), paint(rng, (0.2, 0.2, 0.22))),
            boxes((0.5, -0.35, 0.35), (0.35, 0.4, 0.7), paint(rng, neutral(rng, 0.4, 0.8))),
        ]
    )


def radiator(rng: np.random.Generator, width: float) -> Quads:
    """Ribs below a window."""
    x = np.arange(0.05 - width / 2, width / 2, 0.1)
    ribs = np.stack((x, 0 * x - 0.09, 0 * x + 0.45), axis=1)
    return boxes(ribs, (0.06, 0.1, 0.6), paint(rng, (0.9, 0.9, 0.88), count=len(x)))


def extinguisher(rng: np.random.Generator) -> Quads:
    """A red cylinder on the wall below its sign."""
    red = (0.75, 0.08, 0.06)
    sign = paint(rng, red, (1, 1, 1), pattern="letters", scale=0.1)
    return Quads.join(
        [
            cylinders((0, -0.1, 0.5), 0.08, 0.5, paint(rng, red), sides=12),
            boxes((0, -0.01, 1.6), (0.2, 0.02, 0.2), sign),
        ]
    )
