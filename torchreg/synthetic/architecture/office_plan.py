"""The plan that all floors of an office building share: wings of rooms along corridors, and stairwells.

x runs along the corridors from 0 to ``length``. Wings lie side by side along y, each a corridor with a row of rooms on
both sides; passages along y join the corridors of neighboring wings at both ends. Floors lie above each other, the
lowest at z = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from torchreg.synthetic.architecture.rooms import ROOM_KINDS, Interior, RoomKind
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.paint import muted, neutral

STAIR_MODULES = 3  # width of a stairwell


@dataclass(frozen=True, kw_only=True)
class PlanCell:
    """A room or a stairwell in the plan; its own frame is that of ``rooms.py``."""

    kind: RoomKind | None  # None for a stairwell
    x: float  # meters, the middle of its front
    y: float  # meters, of its front
    facing: int  # 1 where it lies towards +y of its corridor, -1 towards -y
    outside: bool  # whether its back is an outer wall with windows
    door_at_left: bool  # whether there is an open door to the neighbor at its own left (-x of its own frame)
    last: bool  # whether it is the last one of its row to its own right
    interior: Interior
    stations: tuple[tuple[float, float], ...]  # x, y of tripods in its own frame

    def in_plan(self, x: float, y: float) -> tuple[float, float]:
        """A place of its own frame in the plan."""
        return self.x + self.facing * x, self.y + self.facing * y


@dataclass(frozen=True, eq=False, kw_only=True)
class BuildingPlan:
    """Sizes in meters and colors in sRGB of a building, and what lies along its corridors."""

    floors: int  # a count
    storey: float  # from floor to floor
    height: float  # from floor to ceiling
    module: float  # all rooms are whole modules wide
    length: float  # of the wings
    wings: int  # a count
    corridor: float  # width
    depth: float  # of the rooms
    cells: tuple[PlanCell, ...]
    walls: Array  # (3,)
    frames: Array  # (3,) doors and windows
    accents: Array  # (floors, 3) signs and painted walls of each floor

    @property
    def passage(self) -> float:
        """Width of the passages between wings; 0 where there is one wing."""
        return self.corridor if self.wings > 1 else 0.0

    def corridor_y(self, wing: int) -> float:
        """y of the middle of a wing's corridor."""
        return wing * (self.corridor + 2 * self.depth)

    @property
    def stairwells(self) -> tuple[PlanCell, ...]:
        """The cells with stairs."""
        return tuple(cell for cell in self.cells if cell.kind is None)


def draw_building_plan(rng: np.random.Generator, *, floors: int, wings: int, modules: int) -> BuildingPlan:
    """A random plan with so many floors and wings, each wing so many modules long."""
    module, depth, corridor = rng.uniform(1.2, 1.3), rng.uniform(5.2, 5.9), rng.uniform(2.2, 2.7)
    height, storey = rng.uniform(2.7, 2.9), rng.uniform(3.3, 3.6)
    cells: list[PlanCell] = []
    for wing in range(wings):
        for facing in (-1, 1):
            stairs = floors > 1 and (facing == (-1) ** (wing + 1) or modules > 44)
            y = wing * (corridor + 2 * depth) + facing * corridor / 2
            outside = (wing, facing) in ((0, -1), (wings - 1, 1))
            kinds = _row(rng, modules, stairs=stairs)
            cells += _cells(rng, kinds, facing, y, module * modules, module, (depth, height), outside=outside)
    return BuildingPlan(
        floors=floors,
        storey=storey,
        height=height,
        module=module,
        length=module * modules,
        wings=wings,
        corridor=corridor,
        depth=depth,
        cells=tuple(cells),
        walls=neutral(rng, 0.82, 0.95)[0],
        frames=(muted(rng) if rng.random() < 0.5 else neutral(rng, 0.3, 0.8))[0],
        accents=muted(rng, floors),
    )


def _row(rng: np.random.Generator, modules: int, *, stairs: bool) -> list[RoomKind | None]:
    """Kinds of the cells of a row, from left to right; ``None`` is the stairwell."""
    if not stairs:
        return _rooms(rng, modules)
    choices = [left for left in range(modules - STAIR_MODULES + 1) if left != 1 and modules - STAIR_MODULES - left != 1]
    middle = [left for left in choices if 0.2 <= left / modules <= 0.6] or choices
    left = int(rng.choice(middle))
    return [*_rooms(rng, left), None, *_rooms(rng, modules - STAIR_MODULES - left)]


def _rooms(rng: np.random.Generator, modules: int) -> list[RoomKind | None]:
    rooms: list[RoomKind | None] = []
    while modules:
        fitting = [kind for kind in ROOM_KINDS if modules - kind.modules == 0 or modules - kind.modules >= 2]
        weights = np.array([kind.weight for kind in fitting])
        kind = fitting[int(rng.choice(len(fitting), p=weights / weights.sum()))]
        rooms.append(kind)
        modules -= kind.modules
    return rooms


def _cells(
    rng: np.random.Generator,
    kinds: list[RoomKind | None],
    facing: int,
    y: float,
    length: float,
    module: float,
    size: tuple[float, float],
    *,
    outside: bool,
) -> list[PlanCell]:
    depth, height = size
    through_y = 0.62 * depth  # of the doors between rooms
    opened = [i > 0 and None not in kinds[i - 1 : i + 1] and rng.random() < 0.3 for i in range(len(kinds))]
    cells, edge = [], 0.0
    for i, kind in enumerate(kinds):
        width = module * (kind.modules if kind else STAIR_MODULES)
        side = int(rng.choice([-1, 1]))
        door = side * (width / 2 - rng.uniform(0.85, 1.0)) if kind else 0.0
        stations = _stations(kind, width, depth, door) if kind else ()
        beside = [(-width / 2, through_y)] * opened[i] + [(width / 2, through_y)] * any(opened[i + 1 : i + 2])
        middle = edge + width / 2
        cells.append(
            PlanCell(
                kind=kind,
                x=middle if facing > 0 else length - middle,
                y=y,
                facing=facing,
                outside=outside,
                door_at_left=opened[i],
                last=i + 1 == len(kinds),
                interior=Interior(width, depth, height, door, (*stations, *beside)),
                stations=stations,
            )
        )
        edge += width
    return cells


def _stations(kind: RoomKind, width: float, depth: float, door: float) -> tuple[tuple[float, float], ...]:
    """Tripods of a room: one behind the door, from where the corridor shows; in wide rooms another far from it.

    Where the door is all that shows of the corridor, the tripod stands close behind it.
    """
    first = (door - math.copysign(0.1, door), (0.19 if kind.front == "closed" else 0.24) * depth)
    return (first,) if width < 6.5 else (first, (-0.6 * door, 0.24 * depth))
