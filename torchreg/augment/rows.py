"""Choosing rows of one cloud by a rank, without asking the device for anything."""

from __future__ import annotations

import math

from torch import Tensor

from torchreg.types import Clouds
from torchreg.types.packing import offsets_of


def count_of(share: float, points: int) -> int:
    """How many of ``points`` a share stands for: rounded up, at least 1 of a cloud that has any."""
    return min(points, max(1, math.ceil(share * points)))


def kept_rows(cloud: Clouds, rank: Tensor, count: int) -> Clouds:
    """The ``count`` rows of one cloud with the least rank (P,), in the order they came in; ties go to the first."""
    if count == len(cloud.points):
        return cloud
    index = rank.argsort(stable=True)[:count].sort().values
    return cloud.rows(index, offsets_of([count]))
