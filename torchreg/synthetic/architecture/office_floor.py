"""Walls, floors and ceilings of one floor of an office building, and what hangs and stands along its corridors."""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.architecture.office_plan import BuildingPlan, PlanCell
from torchreg.synthetic.architecture.rooms import Interior, at_wall, stand
from torchreg.synthetic.architecture.walls import THICKNESS, Opening, wall, window_frame
from torchreg.synthetic.furniture import indoor, office
from torchreg.synthetic.scene.draws import Draws
from torchreg.synthetic.scene.paint import muted, neutral, paint
from torchreg.synthetic.scene.quads import Quads, boxes, rectangles, up

DOOR_WIDTH, DOOR_HEIGHT = 1.05, 2.1
STAIR_DOOR = Opening(0.0, 2.0, 0.0, 2.3)


def room_shell(plan: BuildingPlan, cell: PlanCell, draws: Draws) -> list[Quads]:
    """Floor, ceiling, walls, doors and windows of a room in its own frame, and what is on the wall to the corridor."""
    assert cell.kind is not None
    room = cell.interior
    opening, others = _FRONTS[cell.kind.front](room)
    front = wall(draws.look(0), plan.walls, room.width, plan.storey, [opening, *others])
    parts = [front.placed(0, THICKNESS / 2), *_ground(room, draws)]
    parts += [*side_walls(plan, cell, draws), *_back(plan, cell, draws)]
    parts += [window_frame(draws.look(0), plan.frames, glass, plan.module).placed(0, THICKNESS / 2) for glass in others]
    if opening.width == DOOR_WIDTH:
        parts += _door(plan, room, draws)
    if opening.width == DOOR_WIDTH and not others:
        parts += _on_the_front(room, draws)
    return parts


def _beside_door(room: Interior) -> tuple[float, float]:
    """From where to where along the front the wall is free, x in meters."""
    half = DOOR_WIDTH / 2 + 0.15
    edge = room.width / 2 - 0.25
    return (-edge, room.door - half) if room.door > 0 else (room.door + half, edge)


def _closed(room: Interior) -> tuple[Opening, list[Opening]]:
    return Opening(room.door, DOOR_WIDTH, 0.0, DOOR_HEIGHT), []


def _glazed(room: Interior) -> tuple[Opening, list[Opening]]:
    left, right = _beside_door(room)
    return _closed(room)[0], [Opening((left + right) / 2, right - left, 0.35, DOOR_HEIGHT)]


def _open(room: Interior) -> tuple[Opening, list[Opening]]:
    return Opening(0.0, room.width - 0.5, 0.0, 2.45), []


_FRONTS = {"closed": _closed, "glazed": _glazed, "open": _open}


def _on_the_front(room: Interior, draws: Draws) -> list[Quads]:
    """What hangs and stands in the corridor beside a door."""
    left, right = _beside_door(room)
    if right - left < 1.0:
        return []
    x = (left + right) / 2
    hung = [(office.picture, 0.45), (office.notice_board, 0.3), (office.extinguisher, 0.2), (office.cabinet, 0.2)]
    stood = [(indoor.litter_bin, 0.2), (indoor.planter, 0.2)]
    parts = []
    for make, share in hung:
        parts += at_wall(draws, make, x, 0.0, loose=0.25, there=share, change=0.8)
    for make, share in stood:
        parts += stand(draws, make, x + 0.2, -0.4, loose=0.15, there=share, change=0.8)
    return parts


def side_walls(plan: BuildingPlan, cell: PlanCell, draws: Draws) -> list[Quads]:
    """The wall at the left of a room or stairwell, in its own frame, and at the right of the last one of a row."""
    room = cell.interior
    through = [Opening(0.12 * room.depth, 0.95, 0.0, DOOR_HEIGHT)] if cell.door_at_left else []
    colored = draws.look(0.5)
    color = muted(colored)[0] if colored.random() < 0.25 else plan.walls
    turned = wall(draws.look(0.3), color, room.depth, plan.storey, through)
    parts = [turned.placed(-room.width / 2, room.depth / 2, yaw=np.pi / 2)]
    if cell.last:
        parts.append(
            wall(draws.look(0), plan.walls, room.depth, plan.storey).placed(
                room.width / 2, room.depth / 2, yaw=np.pi / 2
            )
        )
    return parts


def corridors(plan: BuildingPlan, floor: int, draws: Draws) -> list[Quads]:
    """Floors, ceilings and outer walls of all corridors and passages, at z = 0."""
    wide, long, aside = plan.corridor, plan.length, plan.passage
    look, accent = draws.look(0), plan.accents[floor]
    ground = neutral(look, 0.4, 0.75)[0] if look.random() < 0.5 else muted(look)[0]
    strips = [(long / 2, plan.corridor_y(wing), long + 2 * aside, wide) for wing in range(plan.wings)]
    passage_y = [(plan.corridor_y(wing) + plan.corridor_y(wing + 1)) / 2 for wing in range(plan.wings - 1)]
    ends = (-aside / 2, long + aside / 2)
    strips += [(x, y, aside, 2 * plan.depth) for y in passage_y for x in ends]
    x, y, size_x, size_y = np.array(strips).T
    low, high = np.stack((x, y, 0 * x), axis=1), np.stack((x, y, 0 * x + plan.height), axis=1)
    edge_u, edge_v = size_x[:, None] * [1.0, 0, 0], size_y[:, None] * [0, 1.0, 0]
    tiles = paint(look, ground, 0.9 * ground, count=len(x), pattern="tiles", scale=0.5)
    panels = paint(look, (0.9, 0.9, 0.9), (0.65, 0.65, 0.65), count=len(x), pattern="panels", scale=0.6)
    parts = [rectangles(low, edge_u, edge_v, tiles), rectangles(high, edge_u, edge_v, panels)]
    window = Opening(0.0, wide - 0.9, 0.9, 2.3)
    sides = [(-aside - 0.06, plan.corridor_y(wing), wide) for wing in range(plan.wings)]
    sides += [(long + aside + 0.06, plan.corridor_y(wing), wide) for wing in range(plan.wings)]
    for x_end, y_end, length in sides:
        end = [wall(draws.look(0), accent, length, plan.height, [window])]
        end.append(window_frame(draws.look(0), plan.frames, window, 1.0))
        parts += [piece.placed(x_end, y_end, yaw=np.pi / 2) for piece in end]
    for y_middle in passage_y:
        panes = [Opening(at * plan.depth, 0.6 * plan.depth, 0.9, 2.3) for at in (-0.5, 0.5)]
        for x_outer in (-aside - 0.06, long + aside + 0.06):
            long_wall = [wall(draws.look(0), plan.walls, 2 * plan.depth, plan.height, panes)]
            long_wall += [window_frame(draws.look(0), plan.frames, pane, 1.2) for pane in panes]
            parts += [piece.placed(x_outer, y_middle, yaw=np.pi / 2) for piece in long_wall]
    if aside:
        for y_outer in (plan.corridor_y(0) - wide / 2 - 0.06, plan.corridor_y(plan.wings - 1) + wide / 2 + 0.06):
            parts += [wall(draws.look(0), accent, aside, plan.height).placed(end_x, y_outer) for end_x in ends]
    return parts


def _ground(room: Interior, draws: Draws) -> list[Quads]:
    """Carpet or wood, and a ceiling of panels with its lamps."""
    look = draws.look(0.5)
    wooden = look.random() < 0.35
    color = neutral(look, 0.4, 0.8)[0] * [1, 0.85, 0.65] if wooden else muted(look)[0]
    ground = paint(look, color, pattern="planks" if wooden else "patches", scale=0.14)
    panels = paint(draws.look(0), (0.92, 0.92, 0.9), (0.68, 0.68, 0.68), pattern="panels", scale=0.6)
    edge_u, edge_v, middle = (room.width, 0, 0), (0, room.depth, 0), room.depth / 2
    lamps = np.array(lamps_of(room)) + up(0.05)
    return [
        rectangles((0, middle, 0), edge_u, edge_v, ground),
        rectangles((0, middle, room.height), edge_u, edge_v, panels),
        boxes(lamps, (1.1, 0.25, 0.05), paint(look, (1, 1, 1), count=len(lamps), glow=2.0)),
    ]


def lamps_of(room: Interior) -> list[tuple[float, float, float]]:
    """Where lamps hang in a room, in its own frame."""
    count = max(1, round(room.width / 3.0))
    x = room.width * ((np.arange(count) + 0.5) / count - 0.5)
    return [(float(place), share * room.depth, room.height - 0.12) for place in x for share in (0.3, 0.7)]


def _back(plan: BuildingPlan, cell: PlanCell, draws: Draws) -> list[Quads]:
    """The wall opposite the door: windows with radiators below them, or a plain wall to the next wing."""
    room = cell.interior
    window = [Opening(0.0, room.width - 0.8, 0.9, 2.35)] if cell.outside else []
    colored = draws.look(0.5)
    color = muted(colored)[0] if colored.random() < 0.3 and not cell.outside else plan.walls
    parts = [wall(draws.look(0.25), color, room.width, plan.height, window)]
    parts += [window_frame(draws.look(0), plan.frames, pane, plan.module) for pane in window]
    parts += [office.radiator(draws.look(0), pane.width - 0.4).placed(0, -0.08) for pane in window]
    return [piece.placed(0, room.depth - THICKNESS / 2) for piece in parts]


def _door(plan: BuildingPlan, room: Interior, draws: Draws) -> list[Quads]:
    """The door's frame, its leaf, which stands open at the wall, and the sign beside it."""
    side, half = (1 if room.door > 0 else -1), DOOR_WIDTH / 2
    posts = [(room.door - half, 0.06, DOOR_HEIGHT / 2), (room.door + half, 0.06, DOOR_HEIGHT / 2)]
    frame = boxes(posts, (0.08, 0.2, DOOR_HEIGHT), paint(draws.look(0), plan.frames, count=2))
    open_by = np.pi / 2 + 0.1 + 0.4 * abs(draws.shift(0.5)[0])
    leaf = boxes(
        (half, 0, DOOR_HEIGHT / 2), (DOOR_WIDTH - 0.08, 0.04, DOOR_HEIGHT - 0.05), paint(draws.look(0), plan.frames)
    )
    yaw = min(open_by, 0.9 * np.pi)
    leaf = leaf.placed(room.door + side * half, 0.14, yaw=yaw if side < 0 else np.pi - yaw)
    look = draws.look(0.8)
    sign = boxes(
        (room.door - side * (half + 0.22), -0.01, 1.55),
        (0.2, 0.02, 0.15),
        paint(look, (0.92, 0.92, 0.92), (0.1, 0.1, 0.1), pattern="letters", scale=0.08),
    )
    return [frame, leaf, sign]
