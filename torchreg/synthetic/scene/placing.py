"""Random places for loose pieces, and which of the two scans see them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.quads import Quads

# The scans (0 source, 1 target) that see a piece, for each of the places where it stands in turn.
FIXED, MOVED, ONLY_SOURCE, ONLY_TARGET = ((0, 1),), ((0,), (1,)), ((0,),), ((1,),)

Contents = tuple[list[Quads], list[Quads]]
DrawPlaces = Callable[[float, np.random.Generator], Array]

_CLEARANCE = 0.8  # meters around a tripod


class Pieces(NamedTuple):
    """Pieces of one kind."""

    make: Callable[[np.random.Generator], Quads]
    radius: float  # meters, of the free circle that a piece needs
    number: int
    seen_by: tuple[tuple[int, ...], ...]  # FIXED, MOVED, ONLY_SOURCE or ONLY_TARGET


def scatter(
    kinds: Sequence[Pieces], draw_places: DrawPlaces, taken: Array, stations: Sequence[Array], rng: np.random.Generator
) -> Contents:
    """The pieces that the source scan and the target scan see, at random places.

    ``draw_places`` draws places (N, 2) for a piece of a radius in meters, of which the first free one is taken;
    ``taken`` (M, 3) is x, y and radius of what already stands there. What would stand right beside a scanner, whose
    poses (4, 4) are ``stations``, is left out of both scans; ``rng`` makes the same draws wherever they are.
    """
    contents: Contents = ([], [])
    for kind in kinds:
        for _ in range(kind.number):
            piece = kind.make(rng)
            for scans in kind.seen_by:
                yaw = 0.5 * math.pi * rng.integers(4) + rng.uniform(-0.2, 0.2)
                spot = _first_free(draw_places(kind.radius, rng), taken, kind.radius)
                if spot is None:
                    continue
                taken = np.vstack((taken, (*spot, kind.radius)))
                if clear_of(stations, spot, kind.radius):
                    for k in scans:
                        contents[k].append(piece.placed(spot[0], spot[1], yaw=yaw))
    return contents


def clear_of(stations: Sequence[Array], spot: Array, radius: float) -> bool:
    """Whether a piece of this radius (meters) at ``spot`` (2,) leaves room for the tripods at ``stations``."""
    return all(math.dist(pose[:2, 3], spot) > radius + _CLEARANCE for pose in stations)


def _first_free(places: Array, taken: Array, radius: float) -> Array | None:
    """The first of the places (N, 2) that keeps clear of all that is ``taken``."""
    apart = np.linalg.norm(places[:, None] - taken[:, :2], axis=2)  # (N, M)
    free = np.flatnonzero((apart > taken[:, 2] + radius).all(axis=1))
    return np.asarray(places[free[0]]) if len(free) else None
