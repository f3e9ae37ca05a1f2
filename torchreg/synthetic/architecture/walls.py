"""Walls with openings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.paint import paint
from torchreg.synthetic.scene.quads import Quads, boxes

THICKNESS = 0.12  # meters, of walls between rooms


class Opening(NamedTuple):
    """A rectangular hole in a wall; glass counts as a hole, as a laser passes it."""

    middle: float  # meters along the wall, from its middle
    width: float  # meters
    low: float  # meters above the floor
    high: float  # meters above the floor


def wall(
    rng: np.random.Generator,
    color: Array,
    length: float,
    height: float,
    openings: Sequence[Opening] = (),
    thickness: float = THICKNESS,
) -> Quads:
    """A wall along x about the origin, of one color (3,) sRGB; openings may not overlap."""
    pieces, edge = [], -length / 2  # x from, x to, z from, z to
    for opening in sorted(openings):
        left, right = opening.middle - opening.width / 2, opening.middle + opening.width / 2
        pieces += [(edge, left, 0.0, height), (left, right, 0.0, opening.low), (left, right, opening.high, height)]
        edge = right
    pieces.append((edge, length / 2, 0.0, height))
    x0, x1, z0, z1 = np.array([piece for piece in pieces if piece[1] > piece[0] and piece[3] > piece[2]]).T
    center = np.stack(((x0 + x1) / 2, 0 * x0, (z0 + z1) / 2), axis=1)
    size = np.stack((x1 - x0, 0 * x0 + thickness, z1 - z0), axis=1)
    return boxes(center, size, paint(rng, color, count=len(x0)))


def window_frame(rng: np.random.Generator, color: Array, opening: Opening, pitch: float) -> Quads:
    """Frame and bars, ``pitch`` meters apart, of a window in a wall along x about the origin."""
    count = max(1, round(opening.width / pitch))
    x = opening.middle + opening.width * (np.arange(count + 1) / count - 0.5)
    middle, tall = (opening.low + opening.high) / 2, opening.high - opening.low
    bars = np.stack((x, 0 * x, 0 * x + middle), axis=1)
    rails = [(opening.middle, 0, opening.low), (opening.middle, 0, opening.high), (opening.middle, 0, middle + 0.3)]
    return Quads.join(
        [
            boxes(bars, (0.07, 0.08, tall), paint(rng, color, count=len(bars))),
            boxes(rails, (opening.width, 0.08, 0.07), paint(rng, color, count=len(rails))),
        ]
    )
