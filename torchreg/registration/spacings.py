"""The spacing of points whose neighborhoods are at hand already."""

from __future__ import annotations

import math

from torchreg.types import Clouds, Neighborhoods
from torchreg.types.packing import spans

_SPACING_NEIGHBOR = 4


def spacings_of(cloud: Clouds, near: Neighborhoods) -> list[float]:
    """Median distance to the fourth nearest other point of every cloud, meters, of the points that have as many."""
    found = []
    slot = min(_SPACING_NEIGHBOR, near.index.shape[1] - 1)
    for begin, end in spans(cloud.offsets):
        square = near.sq_distance[begin:end, slot][near.valid[begin:end, slot]]
        median = float(square.double().sqrt().median()) if len(square) > 0 else math.nan
        found.append(median if median > 0 else 1e-9)
    return found
