"""Parked cars and vans, their length along x."""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.scene.paint import Paint, neutral, paint, vivid
from torchreg.synthetic.scene.quads import Quads, boxes, polygon, prism


def car(rng: np.random.Generator) -> Quads:
    """A hatchback or a sedan: body, glazed cabin with a roof, wheels, lamps."""
    half, wide, tall = rng.uniform(1.9, 2.3), rng.uniform(1.68, 1.82), rng.uniform(1.4, 1.6)
    belt = 0.6 * tall
    back = -0.95 * half if rng.random() < 0.5 else -0.62 * half  # with or without a boot
    body = _lacquer(rng)
    profile = [(-half, 0.3), (half, 0.3), (half, 0.62), (0.52 * half, belt), (-0.9 * half, belt), (-half, 0.75)]
    cabin = [(back, belt), (0.5 * half, belt), (0.12 * half, tall - 0.06), (back + 0.28, tall - 0.06)]
    roof = [(back + 0.25, tall - 0.07), (0.14 * half, tall - 0.07), (0.1 * half, tall), (back + 0.32, tall)]
    return Quads.join(
        [
            prism(profile, wide, body),
            prism(cabin, wide - 0.2, paint(rng, (0.1, 0.12, 0.14))),
            prism(roof, wide - 0.22, body),
            _wheels(rng, (-0.6 * half, 0.62 * half), wide, 0.31),
            _ends(rng, half, wide, 0.66),
        ]
    )


def van(rng: np.random.Generator) -> Quads:
    """A delivery van, with letters on its sides."""
    half, wide, tall = rng.uniform(2.3, 2.7), rng.uniform(1.9, 2.05), rng.uniform(2.0, 2.5)
    body = _lacquer(rng)
    profile = [(-half, 0.32), (half, 0.32), (half, 0.95), (0.72 * half, 1.15), (0.48 * half, tall), (-half, tall)]
    pane = [(0.42 * half, 1.18), (0.715 * half, 1.18), (0.52 * half, tall - 0.2), (0.42 * half, tall - 0.2)]
    letters = paint(rng, body.color, vivid(rng), count=1, pattern="letters", scale=0.4)
    return Quads.join(
        [
            prism(profile, wide, body),
            prism(pane, wide + 0.02, paint(rng, (0.1, 0.12, 0.14))),
            boxes((-0.3 * half, 0, 1.35), (1.0 * half, wide + 0.02, 0.5), letters),
            _wheels(rng, (-0.62 * half, 0.62 * half), wide, 0.34),
            _ends(rng, half, wide, 0.7),
        ]
    )


def _lacquer(rng: np.random.Generator) -> Paint:
    """White, gray and black for most, a strong color for the others."""
    return paint(rng, neutral(rng, 0.12, 0.95) if rng.random() < 0.62 else vivid(rng))


def _wheels(rng: np.random.Generator, x: tuple[float, float], wide: float, radius: float) -> Quads:
    """Tires with hubs, two on either side."""
    rubber, metal = paint(rng, (0.1, 0.1, 0.1)), paint(rng, (0.55, 0.55, 0.57))
    tire, hub = prism(polygon(radius), 0.2, rubber), prism(polygon(0.55 * radius), 0.22, metal)
    places = [(at, side * (wide / 2 - 0.08)) for at in x for side in (-1, 1)]
    return Quads.join([part.placed(*place, radius) for place in places for part in (tire, hub)])


def _ends(rng: np.random.Generator, half: float, wide: float, height: float) -> Quads:
    """Lamps and number plates, front and rear."""
    side = 0.5 * wide - 0.22
    lamps = [(end * half, s * side, height - 0.06) for end in (1, -1) for s in (-1, 1)]
    plates = [(half, 0, 0.45), (-half, 0, 0.5)]
    color = [(0.85, 0.85, 0.8)] * 2 + [(0.65, 0.08, 0.08)] * 2 + [(0.9, 0.9, 0.85)] * 2
    size = [(0.06, 0.32, 0.14)] * 4 + [(0.05, 0.5, 0.12)] * 2
    return boxes(lamps + plates, size, paint(rng, color))
