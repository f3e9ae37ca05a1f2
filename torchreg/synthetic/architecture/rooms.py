"""Kinds of rooms of an office building, and what stands in them.

A room is built about the middle of its front, on the floor, x along the front and y into the room, as shops are. Rooms
of one kind are alike in size and in where things stand; how much differs between two floors is the ``Draws``' matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from torchreg.synthetic.furniture import indoor, office
from torchreg.synthetic.scene.draws import Draws
from torchreg.synthetic.scene.paint import paint, vivid
from torchreg.synthetic.scene.quads import Quads, balls

Make = Callable[[np.random.Generator], Quads]

_ELBOW_ROOM = 0.45  # meters that are kept free around a tripod, and in front of doors


class Interior(NamedTuple):
    """The inside of a room in its own frame, meters."""

    width: float  # along the front
    depth: float
    height: float
    door: float  # x of the middle of the door
    keep_clear: tuple[tuple[float, float], ...]  # x, y of tripods and of doors to the next rooms


@dataclass(frozen=True, kw_only=True)
class RoomKind:
    """Rooms of one use."""

    name: str
    modules: int  # width in modules of the building
    weight: float  # how often there is one, relative to the other kinds
    front: str  # "closed": a wall with a door; "glazed": of glass beside the door; "open": none at all
    furnish: Callable[[Interior, Draws], list[Quads]]


def furnished(kind: RoomKind, room: Interior, draws: Draws) -> list[Quads]:
    """What stands in a room, clear of tripods and doors."""
    return [piece for piece in kind.furnish(room, draws) if _leaves_free(piece, room.keep_clear)]


def _leaves_free(piece: Quads, places: tuple[tuple[float, float], ...]) -> bool:
    low, high = piece.corners[..., :2].min(axis=(0, 1)), piece.corners[..., :2].max(axis=(0, 1))
    return all(np.linalg.norm(place - np.clip(place, low, high)) > _ELBOW_ROOM for place in np.array(places))


def stand(
    draws: Draws,
    make: Make,
    x: float,
    y: float,
    yaw: float = 0.0,
    *,
    loose: float = 0.06,
    there: float = 1.0,
    change: float = 0.5,
) -> list[Quads]:
    """A piece about its place, if it is there at all; what leans on a wall stands at ``at_wall``.

    ``loose`` is how far it may stand from there on a floor (meters, and as many radians times two), ``there`` the
    probability that there is one, and ``change`` the probability that a floor has another one, or none, or one of its
    own.
    """
    chance, look, shift = draws.look(change), draws.look(change), draws.shift(loose)
    if chance.random() >= there:
        return []
    return [make(look).placed(x + shift[0], y + shift[1], yaw=yaw + 2 * shift[2])]


def at_wall(
    draws: Draws,
    make: Make,
    x: float,
    y: float,
    yaw: float = 0.0,
    *,
    loose: float = 0.1,
    there: float = 1.0,
    change: float = 0.5,
) -> list[Quads]:
    """As ``stand``, but with its back to a wall, along which alone it may be shifted."""
    chance, look, shift = draws.look(change), draws.look(change), draws.shift(loose)
    if chance.random() >= there:
        return []
    return [make(look).placed(shift[0], 0).placed(x, y, yaw=yaw)]


def at_side(draws: Draws, make: Make, room: Interior, side: int, y: float, **how: float) -> list[Quads]:
    """A piece with its back to the wall on the right (``side`` 1) or on the left (-1)."""
    return at_wall(draws, make, side * (room.width / 2 - 0.08), y, -side * np.pi / 2, **how)


def _shelf(rng: np.random.Generator, width: float) -> Quads:
    return indoor.shelf(rng, width).placed(0, -0.24)


def _workplace(draws: Draws, x: float, y: float, yaw: float) -> list[Quads]:
    behind = y - 0.75 * np.cos(yaw), x + 0.75 * np.sin(yaw)
    return [
        *stand(draws, office.desk, x, y, yaw, loose=0.1, change=0.7, there=0.95),
        *stand(draws, office.swivel_chair, behind[1], behind[0], yaw + np.pi, loose=0.25, change=0.4),
    ]


def _walls(room: Interior, draws: Draws) -> list[Quads]:
    """Pictures and boards on the walls beside the front."""
    door = 1 if room.door > 0 else -1
    return [
        *at_side(draws, office.picture, room, door, 0.55 * room.depth, there=0.7, change=0.9),
        *at_side(draws, office.picture, room, -door, 0.25 * room.depth, there=0.6, change=0.9),
        *stand(draws, indoor.litter_bin, -door * (room.width / 2 - 0.4), 0.5, loose=0.1, there=0.7),
    ]


def _office(room: Interior, draws: Draws) -> list[Quads]:
    door = 1 if room.door > 0 else -1
    turned = draws.look(0.6).random() < 0.4
    x, yaw = (-door * 0.1, 0.0) if turned else (-door * (room.width / 2 - 1.0), door * np.pi / 2)
    return [
        *_walls(room, draws),
        *_workplace(draws, x, room.depth - 1.4, yaw),
        *at_side(draws, partial(_shelf, width=1.6), room, -door, 0.4 * room.depth, change=0.8, there=0.8),
        *at_side(draws, office.cabinet, room, door, 0.8 * room.depth, change=0.6, there=0.7),
        *stand(draws, office.plain_chair, -door * 0.2, 0.5 * room.depth, 2.6, loose=0.15, there=0.7),
        *stand(draws, indoor.planter, door * (room.width / 2 - 0.5), room.depth - 0.75, there=0.4, change=0.5),
    ]


def _shared_office(room: Interior, draws: Draws) -> list[Quads]:
    door = 1 if room.door > 0 else -1
    y = room.depth - (1.7 if draws.look(0.6).random() < 0.5 else 2.2)
    return [
        *_walls(room, draws),
        *_workplace(draws, -0.45, y, -np.pi / 2),
        *_workplace(draws, 0.45, y, np.pi / 2),
        *at_side(draws, partial(_shelf, width=2.4), room, -door, 0.4 * room.depth, change=0.8),
        *at_side(draws, office.whiteboard, room, door, 0.45 * room.depth, change=0.8, there=0.6),
        *at_side(draws, office.cabinet, room, door, 0.85 * room.depth, change=0.6, there=0.6),
        *stand(
            draws, indoor.cartons, -door * (room.width / 2 - 0.5), room.depth - 0.6, loose=0.2, there=0.5, change=0.6
        ),
    ]


def _meeting(room: Interior, draws: Draws) -> list[Quads]:
    length, y = room.width - 2.4, 0.62 * room.depth
    x = np.linspace(-0.4, 0.4, 4) * length
    chairs = [
        piece
        for place in x
        for side in (-1, 1)
        for piece in stand(
            draws, office.swivel_chair, place, y + side * 0.85, np.pi / 2 * (1 - side), loose=0.2, there=0.9
        )
    ]
    return [
        *_walls(room, draws),
        *chairs,
        *stand(draws, partial(office.long_table, length=length), 0, y, change=0.6),
        *at_side(draws, office.whiteboard, room, 1, 0.6 * room.depth, change=0.8),
        *at_side(draws, office.cabinet, room, -1, 0.6 * room.depth, there=0.7, change=0.7),
        *stand(draws, indoor.planter, room.width / 2 - 0.6, room.depth - 0.8, there=0.6, change=0.4),
    ]


def _kitchen(room: Interior, draws: Draws) -> list[Quads]:
    door = 1 if room.door > 0 else -1
    unit, x, y = partial(office.kitchen_unit, width=0.55 * room.depth), door * 0.25, room.depth - 1.6
    chairs = [(0, -0.75, np.pi), (0, 0.75, 0.0), (0.85, 0.0, -np.pi / 2), (-0.85, 0.0, np.pi / 2)]
    return [
        *_walls(room, draws),
        *at_side(draws, unit, room, -door, 0.6 * room.depth, change=0.5),
        *stand(draws, partial(office.long_table, length=0.9, width=0.9), x, y, change=0.4),
        *(
            piece
            for dx, dy, yaw in chairs
            for piece in stand(draws, office.plain_chair, x + dx, y + dy, yaw, loose=0.12, there=0.8)
        ),
        *stand(draws, indoor.litter_bin, door * (room.width / 2 - 0.4), room.depth - 0.6, loose=0.1, there=0.9),
    ]


def _store(room: Interior, draws: Draws) -> list[Quads]:
    side = -1 if room.door > 0 else 1
    cartons = [
        piece
        for y in (0.55, 0.75, 0.9)
        for piece in stand(draws, indoor.cartons, -0.5 * side, y * room.depth, loose=0.25, there=0.6, change=0.8)
    ]
    return [
        *at_side(draws, partial(_shelf, width=0.7 * room.depth), room, side, 0.55 * room.depth, change=0.7),
        *stand(draws, office.copier, 0, room.depth - 0.3, there=0.6),
        *cartons,
    ]


def _open_plan(room: Interior, draws: Draws) -> list[Quads]:
    groups = np.linspace(-0.5, 0.5, 3) * (room.width - 3.4)
    desks = [
        piece
        for x in groups
        for y in (room.depth - 1.5, room.depth - 3.2)
        for side in (-1, 1)
        for piece in _workplace(draws, x + 0.45 * side, y, side * np.pi / 2)
    ]
    return [
        *_walls(room, draws),
        *desks,
        *at_side(draws, partial(_shelf, width=2.0), room, 1, 0.6 * room.depth, change=0.5),
        *at_side(draws, office.whiteboard, room, -1, 0.6 * room.depth, change=0.5, there=0.7),
        *stand(draws, indoor.planter, 0.25 * room.width, 0.7, there=0.7, change=0.4),
        *stand(draws, indoor.planter, -0.25 * room.width, 0.7, there=0.7, change=0.4),
        *stand(draws, _ball, -0.4 * room.width, 1.2, loose=0.5, there=0.3, change=0.8),
    ]


def _ball(rng: np.random.Generator) -> Quads:
    """A ball to sit on."""
    return balls((0, 0, 0.33), (0.33, 0.33, 0.33), paint(rng, vivid(rng)))


def _lounge(room: Interior, draws: Draws) -> list[Quads]:
    table = partial(office.long_table, length=0.9, width=0.6)
    return [
        *at_side(draws, office.sofa, room, -1, 0.55 * room.depth, change=0.7),
        *at_side(draws, office.sofa, room, 1, 0.6 * room.depth, there=0.6, change=0.7),
        *stand(draws, table, 0.1, 0.65 * room.depth, np.pi / 2, loose=0.15, change=0.6),
        *at_wall(draws, office.notice_board, 0, room.depth - 0.14, there=0.5, change=0.9),
        *at_side(draws, partial(_shelf, width=1.4), room, 1, 0.25 * room.depth, there=0.6, change=0.8),
        *stand(draws, indoor.planter, -room.width / 2 + 0.6, room.depth - 0.7, there=0.8, change=0.6),
        *stand(draws, indoor.planter, room.width / 2 - 0.6, room.depth - 0.7, there=0.5, change=0.6),
        *stand(draws, indoor.board, 0.5, 0.35 * room.depth, 0.5, loose=0.3, there=0.5, change=0.9),
    ]


ROOM_KINDS = (
    RoomKind(name="office", modules=3, weight=4, front="closed", furnish=_office),
    RoomKind(name="shared-office", modules=4, weight=3, front="glazed", furnish=_shared_office),
    RoomKind(name="meeting", modules=5, weight=1.5, front="glazed", furnish=_meeting),
    RoomKind(name="kitchen", modules=3, weight=1, front="glazed", furnish=_kitchen),
    RoomKind(name="store", modules=2, weight=0.8, front="closed", furnish=_store),
    RoomKind(name="lounge", modules=3, weight=1, front="open", furnish=_lounge),
    RoomKind(name="open-plan", modules=7, weight=0.8, front="glazed", furnish=_open_plan),
)
