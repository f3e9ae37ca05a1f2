"""Which pieces of furniture stand where in the hall, and in which of the two scans."""

from __future__ import annotations

import numpy as np

from torchreg.synthetic import furniture
from torchreg.synthetic.hall import HallPlan
from torchreg.synthetic.placing import FIXED, MOVED, ONLY_SOURCE, ONLY_TARGET, Contents, Kind, scatter
from torchreg.synthetic.scene.arrays import Array

_KINDS = (
    Kind(furniture.kiosk, 1.9, 3, FIXED),
    Kind(furniture.bench, 1.0, 5, FIXED),
    Kind(furniture.planter, 0.6, 7, FIXED),
    Kind(furniture.board, 0.5, 4, FIXED),
    Kind(furniture.litter_bin, 0.3, 4, FIXED),
    Kind(furniture.cartons, 0.5, 5, FIXED),
    Kind(furniture.cartons, 0.5, 5, MOVED),
    Kind(furniture.person, 0.4, 6, ONLY_SOURCE),
    Kind(furniture.person, 0.4, 6, ONLY_TARGET),
)


def furnish(plan: HallPlan, stations: list[Array], rng: np.random.Generator) -> Contents:
    """The pieces that the source scan and the target scan see.

    Args:
        plan: the hall, with columns to keep clear of.
        stations: poses (4, 4) of the scanners; what would stand right beside one is left out of both scans.
        rng: the same draws wherever the stations are.
    """

    def anywhere(radius: float, rng: np.random.Generator) -> Array:
        half = np.array([plan.length / 2, plan.width / 2]) - radius - 0.5
        return rng.uniform(-half, half, (100, 2))

    taken = np.pad(plan.columns, ((0, 0), (0, 1)), constant_values=plan.column_size)  # (N, 3): x, y, radius
    return scatter(_KINDS, anywhere, taken, stations, rng)
