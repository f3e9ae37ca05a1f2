"""Random draws for floors of one plan: most are the same on all floors, some are a floor's own."""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.scene import Array

_SETTLED = 0.25  # share of the parts that change little


class Draws:
    """A series of generators for one part of a building, say a room, on one floor.

    The n-th generator has the same stream on all floors, unless a floor has its own there, so that what is built from
    it looks the same; whether a floor has its own shifts nothing else.
    """

    def __init__(self, key: tuple[int, ...], floor: int, variety: float) -> None:
        """``key`` names the part, alike on all floors; ``variety`` is 0 where floors are alike in everything.

        One part in four changes little from floor to floor.
        """
        settled = np.random.default_rng((*key, 0, 2)).random() < _SETTLED
        self._key, self._floor, self._count = key, floor, 0
        self._variety = (0.4 if settled else 1.0) * variety

    def look(self, change: float) -> np.random.Generator:
        """The next generator; this floor's own with the probability ``change`` times the variety."""
        self._count += 1
        alike = (*self._key, self._count)
        own = (*alike, 1 + self._floor)
        changes = np.random.default_rng((*own, 1)).random() < change * self._variety
        return np.random.default_rng((*own, 0) if changes else (*alike, 0, 0))

    def shift(self, scale: float) -> Array:
        """How far a piece stands from its place on this floor: (3,), normal, of deviation ``scale`` times variety."""
        self._count += 1
        own = np.random.default_rng((*self._key, self._count, 1 + self._floor))
        return np.asarray(self._variety * scale * own.standard_normal(3))
