"""A street: its sizes, the ground, and the houses along it.

The road runs along x about the origin, its surface at z = 0. Outwards on either side follow, where there is one, a
lane of parked cars, the kerb with the pavement, a lawn with trees, and the buildings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from torchreg.synthetic.architecture.houses import house
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.paint import from_hsv, neutral, paint
from torchreg.synthetic.scene.quads import Quads, at_height, boxes, cylinders, rectangles

SIDES = (-1, 1)
LEVEL = 0.12  # meters, pavement and lawn above the road
_LANE = 2.2  # meters, width of a parking lane
_BEYOND = 60.0  # meters that the ground goes on behind the ends of the plan
_CELL = 1.0  # meters, of the lawn's height field


@dataclass(frozen=True, kw_only=True)
class StreetPlan:
    """The sizes of a road, in meters unless stated. Of a pair, the first is the side of negative y."""

    length: float  # of what is built; more buildings close both ends
    width: float  # of the lanes that cars drive on
    parking: tuple[bool, bool]  # whether there is a lane for parked cars
    pavement: tuple[float, float]  # width of the pavements
    lawn: tuple[float, float]  # width of the lawns, between pavement and buildings
    slot: float  # length of one parking place
    crossing: float  # x of the zebra crossing

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
    """Random sizes of a street."""
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


def ground(plan: StreetPlan, rng: np.random.Generator) -> Quads:
    """The roadway, and a pavement and a lawn on either side."""
    parts = [_roadway(plan, rng), _markings(plan, rng), _covers(plan, rng)]
    for side in SIDES:
        parts += [_pavement(plan, side, rng), _lawn(plan, side, rng)]
    return Quads.join(parts)


def houses(plan: StreetPlan, rng: np.random.Generator) -> Quads:
    """Buildings of different lengths with gaps between them on both sides, and one across each end."""
    parts = []
    for side in SIDES:
        x = -plan.length / 2 - rng.uniform(0, 6)
        while x < plan.length / 2 - 8:
            length, depth = rng.uniform(13, 25), rng.uniform(9, 13)
            front = plan.front(side) + rng.uniform(0, 2.5)
            yaw = math.pi if side < 0 else 0.0
            parts.append(house(rng, length, depth).placed(x + length / 2, side * front, LEVEL, yaw=yaw))
            x += length + rng.uniform(3, 9)
    for side in SIDES:
        across = house(rng, rng.uniform(20, 28), rng.uniform(9, 13))
        place = side * (plan.length / 2 + rng.uniform(2, 8))
        parts.append(across.placed(place, rng.uniform(-5, 5), yaw=-side * math.pi / 2))
    return Quads.join(parts)


def _roadway(plan: StreetPlan, rng: np.random.Generator) -> Quads:
    """Asphalt as far as one sees, patched here and there; parking lanes are paved."""
    gray = neutral(rng, 0.3, 0.42)
    asphalt = paint(rng, gray, 0.8 * gray, pattern="patches", scale=2.5)
    reach = plan.length + 2 * _BEYOND
    count = int(rng.integers(3, 7))
    spots = rng.uniform((-30, -0.35 * plan.width), (30, 0.35 * plan.width), (count, 2))
    mended = paint(rng, rng.uniform(0.6, 0.85, (count, 1)) * gray)
    edge_u, edge_v = np.zeros((2, count, 3))
    edge_u[:, 0], edge_v[:, 1] = rng.uniform(1, 5, count), rng.uniform(0.6, 1.6, count)
    parts = [
        rectangles((0, 0, 0), (reach, 0, 0), (0, reach, 0), asphalt),
        rectangles(np.column_stack((spots, np.full(count, 0.003))), edge_u, edge_v, mended),
    ]
    for side in SIDES:
        if plan.parking[side > 0]:
            stone = _stone(rng)
            paving = paint(rng, stone, 0.85 * stone, pattern="tiles", scale=0.2)
            across = plan.kerb(side) - plan.width / 2
            parts.append(rectangles((0, side * plan.lane, 0.002), (plan.length, 0, 0), (0, across, 0), paving))
    return Quads.join(parts)


def _markings(plan: StreetPlan, rng: np.random.Generator) -> Quads:
    """A broken line along the middle, the zebra crossing, and lines between parking places."""
    white, height = rng.uniform(0.75, 0.9) * np.ones(3), 0.006
    x = np.arange(-plan.length / 2, plan.length / 2, 6.0)
    x = x[np.abs(x - plan.crossing) > 4]
    stripe = np.arange(0.5 - plan.width / 2, plan.width / 2 - 0.2, 1.0)
    parts = [
        rectangles(at_height(x, 0.0, height), (3, 0, 0), (0, 0.12, 0), paint(rng, white, count=len(x))),
        rectangles(
            at_height(plan.crossing, stripe, height), (3, 0, 0), (0, 0.5, 0), paint(rng, white, count=len(stripe))
        ),
    ]
    for side in SIDES:
        if plan.parking[side > 0]:
            between = plan.slots - plan.slot / 2
            place = at_height(between, side * plan.lane, height)
            parts.append(rectangles(place, (0.1, 0, 0), (0, 2.0, 0), paint(rng, white, count=len(place))))
    return Quads.join(parts)


def _covers(plan: StreetPlan, rng: np.random.Generator) -> Quads:
    """Round covers of manholes."""
    count = 4
    place = np.pad(rng.uniform((-25, -0.3 * plan.width), (25, 0.3 * plan.width), (count, 2)), ((0, 0), (0, 1)))
    return cylinders(place, 0.32, 0.01, paint(rng, (0.2, 0.19, 0.18), count=count), sides=20)


def _pavement(plan: StreetPlan, side: int, rng: np.random.Generator) -> Quads:
    """Slabs behind a kerb of stones."""
    kerb, width, edge = plan.kerb(side), plan.pavement[side > 0], 0.15
    stone = neutral(rng, 0.5, 0.7)
    x = np.arange(-plan.length / 2 + 0.5, plan.length / 2, 1.0)
    tones = rng.uniform(0.9, 1.1, (len(x), 1)) * stone
    slab = _stone(rng)
    slabs = paint(rng, slab, 0.9 * slab, pattern="tiles", scale=rng.uniform(0.3, 0.5))
    middle = side * (kerb + (width + edge) / 2)
    return Quads.join(
        [
            boxes(at_height(x, side * (kerb + edge / 2), LEVEL / 2), (0.99, edge, LEVEL), paint(rng, tones)),
            rectangles((0, middle, LEVEL - 0.005), (plan.length, 0, 0), (0, width - edge, 0), slabs),
        ]
    )


def _lawn(plan: StreetPlan, side: int, rng: np.random.Generator) -> Quads:
    """Grass in shades of green and straw on a gently uneven height field."""
    near, far = plan.lawn_from(side), plan.front(side) + 14
    x, y = np.arange(-plan.length / 2 - 10, plan.length / 2 + 10, _CELL), np.arange(near, far + _CELL, _CELL)
    waves = rng.uniform((-0.5, -0.7, 0), (0.5, 0.7, 2 * np.pi), (6, 3))
    phase = x[:, None, None] * waves[:, 0] + y[:, None] * waves[:, 1] + waves[:, 2]  # (X, Y, 6)
    fades = np.clip((y - near) / 2, 0, 1) * np.clip((plan.front(side) - y) / 2, 0, 1)
    height = LEVEL + 0.045 * fades * (np.sin(phase).sum(axis=2) + 1)
    grid = np.stack((*np.meshgrid(x, side * y, indexing="ij"), height), axis=2)
    corners = np.stack((grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]), axis=2).reshape(-1, 4, 3)
    green = from_hsv(rng.uniform(0.22, 0.3, 1), rng.uniform(0.45, 0.65, 1), rng.uniform(0.38, 0.5, 1))
    straw = from_hsv(rng.uniform(0.13, 0.2, 1), rng.uniform(0.4, 0.6, 1), rng.uniform(0.45, 0.6, 1))
    grass = paint(rng, green, straw, pattern="patches", scale=rng.uniform(1.0, 2.5))
    return Quads(corners, corners[..., :2].copy(), grass.take(np.zeros(len(corners), dtype=np.int64)))


def _stone(rng: np.random.Generator) -> Array:
    """The color (1, 3) of paving: gray, or reddish to ocher."""
    if rng.random() < 0.6:
        return neutral(rng, 0.42, 0.62)
    return from_hsv(rng.uniform(0.0, 0.11, 1), rng.uniform(0.2, 0.45, 1), rng.uniform(0.42, 0.62, 1))
