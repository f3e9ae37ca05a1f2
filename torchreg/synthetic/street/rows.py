"""The buildings along a road and across both of its ends."""

from __future__ import annotations

import math

import numpy as np

from torchreg.synthetic.scene.quads import Quads
from torchreg.synthetic.street.buildings import building
from torchreg.synthetic.street.plan import LEVEL, SIDES, StreetPlan


def houses(plan: StreetPlan, rng: np.random.Generator) -> Quads:
    """Buildings of different lengths with gaps between them on both sides, and one across each end."""
    parts = []
    for side in SIDES:
        x = -plan.length / 2 - rng.uniform(0, 6)
        while x < plan.length / 2 - 8:
            length, depth = rng.uniform(13, 25), rng.uniform(9, 13)
            front = plan.front(side) + rng.uniform(0, 2.5)
            yaw = math.pi if side < 0 else 0.0
            parts.append(building(rng, length, depth).placed(x + length / 2, side * front, LEVEL, yaw=yaw))
            x += length + rng.uniform(3, 9)
    for side in SIDES:
        across = building(rng, rng.uniform(20, 28), rng.uniform(9, 13))
        place = side * (plan.length / 2 + rng.uniform(2, 8))
        parts.append(across.placed(place, rng.uniform(-5, 5), yaw=-side * math.pi / 2))
    return Quads.join(parts)
