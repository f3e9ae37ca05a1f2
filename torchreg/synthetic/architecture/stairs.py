"""Stairwells: on each floor a landing with a wide opening to the corridor, and two flights with a landing between.

In a stairwell's own frame the landing of the floor lies behind the front; the first flight rises at the right to the
middle landing at the back, the second from there at the left to the next floor.
"""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.architecture.office_floor import STAIR_DOOR, side_walls
from torchreg.synthetic.architecture.office_plan import BuildingPlan, PlanCell
from torchreg.synthetic.architecture.rooms import at_wall, stand
from torchreg.synthetic.architecture.walls import THICKNESS, Opening, wall, window_frame
from torchreg.synthetic.furniture import indoor, office
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.draws import Draws
from torchreg.synthetic.scene.paint import neutral, paint
from torchreg.synthetic.scene.quads import Quads, boxes

FRONT_LANDING, MIDDLE_LANDING = 2.1, 1.3  # meters
_STEPS = 10  # of a flight
_SLAB = 0.25  # meters


def stairwell(plan: BuildingPlan, cell: PlanCell, floor: int, draws: Draws) -> list[Quads]:
    """One floor's part of a stairwell in its own frame, its landing at z = 0."""
    room, half = cell.interior, plan.storey / 2
    width, depth = room.width - THICKNESS, room.depth
    look = draws.look(0)
    stone = neutral(look, 0.45, 0.7)[0]
    top, bottom = floor + 1 == plan.floors, floor == 0
    front = wall(draws.look(0), plan.walls, room.width, plan.storey, [STAIR_DOOR]).placed(0, THICKNESS / 2)
    window = [] if top or not cell.outside else [Opening(0.0, width - 1.4, half + 0.9, half + 1.6)]
    backs = [wall(draws.look(0), plan.walls, room.width, plan.storey, window)]
    backs += [window_frame(draws.look(0), plan.frames, pane, 0.8) for pane in window]
    back = Quads.join(backs).placed(0, depth - THICKNESS / 2)
    landing = depth if bottom else FRONT_LANDING
    slabs = [(0, landing / 2, -_SLAB / 2, width, landing, _SLAB)]
    if top:
        slabs.append((0, depth / 2, plan.storey + _SLAB / 2, width, depth, _SLAB))
    else:
        slabs.append((0, depth - MIDDLE_LANDING / 2, half - _SLAB / 2, width, MIDDLE_LANDING, _SLAB))
    slab = np.array(slabs)
    tiles = paint(look, stone, 0.85 * stone, count=len(slab), pattern="tiles", scale=0.4)
    parts = [front, back, *side_walls(plan, cell, draws), boxes(slab[:, :3], slab[:, 3:], tiles)]
    if top:
        guard = (width / 4, FRONT_LANDING, 0.55), (width / 2, 0.05, 1.0)
        parts.append(boxes(*guard, paint(look, plan.frames, pattern="stripes", scale=0.1)))
    else:
        parts += _flights(plan, cell, look, stone)
    sign_look = draws.look(1.0)
    letters = paint(sign_look, plan.accents[floor], (1, 1, 1), pattern="letters", scale=0.4)
    parts.append(boxes((width / 2 - 0.02, 0.5 * FRONT_LANDING, 1.6), (0.03, 0.9, 0.7), letters))
    painted = paint(sign_look, plan.accents[floor])
    parts.append(boxes((0.02 - width / 2, 0.5 * FRONT_LANDING + 0.1, 1.3), (0.03, FRONT_LANDING - 0.3, 2.4), painted))
    parts += at_wall(draws, office.extinguisher, -1.35, THICKNESS, np.pi, change=0.1)
    parts += stand(draws, indoor.planter, width / 2 - 0.45, 0.55, loose=0.05, there=0.5, change=0.9)
    parts += at_wall(draws, office.cabinet, 0.04 - width / 2, 0.9, np.pi / 2, there=0.4, change=0.9)
    parts += at_wall(draws, office.notice_board, 0.06 - width / 2, 1.1, np.pi / 2, there=0.6, change=0.9)
    if not top:
        notices = at_wall(
            draws, office.notice_board, 0, depth - THICKNESS, loose=0.2, there=0.0 if window else 0.7, change=0.9
        )
        things = stand(draws, indoor.cartons, -width / 2 + 0.4, depth - 0.5, loose=0.05, there=0.4, change=0.9)
        at_side = width / 2 - 0.02, depth - 0.6 * MIDDLE_LANDING, -np.pi / 2
        pictures = at_wall(draws, office.picture, *at_side, there=0.8, change=0.9)
        parts += [piece.placed(0, 0, half) for piece in (*notices, *things, *pictures)]
    return parts


def stair_lamps(plan: BuildingPlan, cell: PlanCell) -> list[tuple[float, float, float]]:
    """Where a stairwell's lamps hang on each floor, in its own frame."""
    return [(0.0, FRONT_LANDING / 2, plan.storey - _SLAB - 0.1), (0.0, cell.interior.depth - 0.3, plan.storey - 0.1)]


def landing_station() -> tuple[float, float, float]:
    """Where a tripod stands on the landing of a floor: x, y of the stairwell's own frame, and height of its feet."""
    return 0.0, 0.55 * FRONT_LANDING, 0.0


def middle_station(plan: BuildingPlan, cell: PlanCell) -> tuple[float, float, float]:
    """Where a tripod stands on the middle landing; see ``landing_station``."""
    return 0.0, cell.interior.depth - 0.75 * MIDDLE_LANDING, plan.storey / 2


def _flights(plan: BuildingPlan, cell: PlanCell, look: np.random.Generator, stone: Array) -> list[Quads]:
    depth, half = cell.interior.depth, plan.storey / 2
    run = depth - FRONT_LANDING - MIDDLE_LANDING
    tread, rise, wide = run / _STEPS, half / _STEPS, (cell.interior.width - THICKNESS - 0.2) / 2
    step = np.arange(_STEPS)
    aside, tall = np.full(_STEPS, wide / 2 + 0.1), rise + 0.12
    first = np.stack((aside, FRONT_LANDING + (step + 0.5) * tread, (step + 1) * rise - tall / 2), axis=1)
    second = np.stack((-aside, depth - MIDDLE_LANDING - (step + 0.5) * tread, half + first[:, 2]), axis=1)
    posts = np.concatenate((first[::2], second[::2]))
    posts[:, 0] = np.sign(posts[:, 0]) * 0.14
    posts[:, 2] += 0.5
    return [
        boxes(np.concatenate((first, second)), (wide, tread, tall), paint(look, stone, count=2 * _STEPS)),
        boxes(posts, (0.04, 0.04, 0.95), paint(look, plan.frames, count=len(posts))),
    ]
