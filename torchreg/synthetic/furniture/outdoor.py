"""Furniture of streets: lamp posts, traffic signs, flags, bollards, containers, shelters, bicycle racks."""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.scene.paint import neutral, paint, vivid
from torchreg.synthetic.scene.quads import Quads, at_height, boxes, cylinders, polygon, prism, up


def lamp_post(rng: np.random.Generator, tall: float) -> Quads:
    """A post of this height with an arm towards the road and its lamp."""
    steel = paint(rng, neutral(rng, 0.35, 0.6))
    return Quads.join(
        [
            cylinders((0, 0, 0), 0.1, 1.0, steel, sides=14),
            cylinders((0, 0, 1.0), 0.06, tall - 1.0, steel, sides=14),
            boxes((0, -0.6, tall - 0.05), (0.07, 1.2, 0.07), steel),
            boxes((0, -1.35, tall - 0.05), (0.25, 0.6, 0.12), paint(rng, (0.6, 0.6, 0.6))),
        ]
    )


def traffic_sign(rng: np.random.Generator) -> Quads:
    """A triangle, a disk or a square on a post."""
    sides, edge = int(rng.choice([3, 4, 24])), rng.uniform(0.3, 0.38)
    turn = {3: 0.5, 4: 0.25, 24: 0.0}[sides] * np.pi
    shape = polygon(edge, sides, turn)
    plate, rim = paint(rng, (0.9, 0.9, 0.88)), paint(rng, vivid(rng))
    return Quads.join(
        [
            cylinders((0, 0, 0), 0.035, 2.5, paint(rng, (0.5, 0.5, 0.52)), sides=10),
            prism(shape, 0.02, rim).placed(0, -0.05, 2.3),
            prism(0.7 * shape, 0.024, plate).placed(0, -0.055, 2.3),
        ]
    )


def flag(rng: np.random.Generator) -> Quads:
    """A tall banner on a mast."""
    cloth = paint(rng, vivid(rng), vivid(rng), pattern="stripes" if rng.random() < 0.5 else "letters", scale=0.5)
    return Quads.join(
        [
            cylinders((0, 0, 0), 0.05, 6.5, paint(rng, (0.8, 0.8, 0.8)), sides=12),
            boxes((0.55, 0, 4.9), (1.0, 0.03, 2.8), cloth),
        ]
    )


def bollards(rng: np.random.Generator, count: int = 5) -> Quads:
    """Posts in a row along x."""
    at = at_height(1.3 * (np.arange(count) - (count - 1) / 2), 0.0, 0.0)
    dark, band = paint(rng, neutral(rng, 0.2, 0.5), count=count), paint(rng, vivid(rng), count=count)
    return Quads.join([cylinders(at, 0.07, 0.9, dark, sides=12), cylinders(at + up(0.65), 0.075, 0.12, band, sides=12)])


def containers(rng: np.random.Generator) -> Quads:
    """Three bins for waste paper, glass and packaging."""
    at, size = at_height([-1.3, 0.0, 1.3], 0.0, 0.0), np.array([1.15, 0.95, 1.15])
    color = np.array([(0.15, 0.3, 0.65), (0.15, 0.45, 0.25), (0.85, 0.7, 0.15)]) * rng.uniform(0.8, 1.1, (3, 1))
    lids = paint(rng, 0.7 * color)
    return Quads.join(
        [
            boxes(at + up(0.62), size, paint(rng, color)),
            boxes(at + up(1.24), (1.2, 1.0, 0.1), lids),
            boxes(at + np.array([0, -0.48, 0.8]), (0.5, 0.03, 0.3), paint(rng, (0.9, 0.9, 0.9), count=3)),
        ]
    )


def shelter(rng: np.random.Generator) -> Quads:
    """A bus shelter: a back of glass, a roof, a bench and a poster."""
    post, roof = paint(rng, (0.3, 0.31, 0.33), count=4), paint(rng, vivid(rng))
    corners = [(-1.7, 0.5, 1.2), (1.7, 0.5, 1.2), (-1.7, -0.5, 1.2), (1.7, -0.5, 1.2)]
    poster = paint(rng, vivid(rng), neutral(rng), pattern="poster", scale=0.3)
    return Quads.join(
        [
            boxes(corners, (0.07, 0.07, 2.4), post),
            boxes((0, 0, 2.45), (3.8, 1.5, 0.12), roof),
            boxes((-0.3, 0.5, 1.2), (2.7, 0.02, 1.9), paint(rng, (0.35, 0.45, 0.45))),
            boxes((1.7, 0, 1.25), (0.12, 0.9, 1.7), poster),
            boxes((-0.3, 0.25, 0.45), (2.2, 0.35, 0.06), paint(rng, (0.5, 0.38, 0.25))),
        ]
    )


def bicycle_rack(rng: np.random.Generator) -> Quads:
    """Steel hoops in a row, a bicycle's frame and wheels leaning on most of them."""
    parts, wheel = [], polygon(0.34, 20)
    for x in 0.75 * (np.arange(5) - 2):
        hoop = [(x, -0.35, 0.4), (x, 0.35, 0.4), (x, 0, 0.8)]
        steel = paint(rng, (0.6, 0.6, 0.62), count=3)
        parts.append(boxes(hoop, [(0.05, 0.05, 0.8), (0.05, 0.05, 0.8), (0.05, 0.75, 0.05)], steel))
        color = vivid(rng)
        if rng.random() < 0.75:
            frame = prism([(-0.35, 0.5), (0.0, 0.35), (0.4, 0.8), (-0.25, 0.85)], 0.05, paint(rng, color))
            tires = [prism(wheel, 0.04, paint(rng, (0.12, 0.12, 0.12))).placed(s * 0.52, 0, 0.34) for s in (-1, 1)]
            parts.append(Quads.join([frame, *tires]).placed(x + 0.12, 0, yaw=np.pi / 2 + rng.uniform(-0.1, 0.1)))
    return Quads.join(parts)
