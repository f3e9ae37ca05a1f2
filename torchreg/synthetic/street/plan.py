"""The sizes of a road and what lies along it.

The road runs along x about the origin, its surface at z = 0. Outwards on either side follow, where there is one, a
lane of parked cars, the kerb with the pavement, a lawn with trees, and the buildings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchreg.synthetic.scene.arrays import Array

SIDES = (-1, 1)
LEVEL = 0.12  # meters, pavement and lawn above the road
_LANE = 2.2  # meters, width of a parking lane


@dataclass(frozen=True, kw_only=True)
class StreetPlan:
    """The sizes of a road, in meters unless stated. Of a pair, the first is the side of negative y.

    Attributes:
        length: of what is built; more buildings close both ends.
        width: of the lanes that cars drive on.
        parking: whether there is a lane for parked cars.
        pavement: width of the pavements.
        lawn: width of the lawns, between pavement and buildings.
        slot: length of one parking place.
        crossing: x of the zebra crossing.
    """

    length: float
    width: float
    parking: tuple[bool, bool]
    pavement: tuple[float, float]
    lawn: tuple[float, float]
    slot: float
    crossing: float

    def kerb(self, side: int) -> float:
        """Distance of the kerb from the middle of the road on a side, -1 or 1."""
        return self.width / 2 + _LANE * self.parking[side > 0]

    @property
    def lane(self) -> float:
        """Distance of the middle of the parking lane from the middle of the road."""
        return self.width / 2 + _LANE / 2

    def lawn_from(self, side: int) -> float:
        """Distance of the lawn's near edge from the middle of the road."""
        return self.kerb(side) + self.pavement[side > 0]

    def front(self, side: int) -> float:
        """Distance of the buildings' fronts from the middle of the road."""
        return self.lawn_from(side) + self.lawn[side > 0]

    @property
    def slots(self) -> Array:
        """(N,) x of the middles of the parking places of one side; none on the zebra crossing."""
        x = np.arange(-0.5 * self.length + 8, 0.5 * self.length - 8, self.slot) + self.slot / 2
        return x[np.abs(x - self.crossing) > self.slot / 2 + 2.5]


def draw_plan(rng: np.random.Generator) -> StreetPlan:
    """Sizes of a road as they occur."""
    both = rng.random() < 0.5
    left = bool(both or rng.random() < 0.5)
    return StreetPlan(
        length=rng.uniform(84, 104),
        width=rng.uniform(5.6, 7.2),
        parking=(left, bool(both or not left)),
        pavement=(rng.uniform(1.8, 3.0), rng.uniform(1.8, 3.0)),
        lawn=(rng.uniform(4.5, 10.0), rng.uniform(4.5, 10.0)),
        slot=rng.uniform(5.4, 6.2),
        crossing=rng.uniform(-14, 14),
    )
