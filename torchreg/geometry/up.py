"""Which way is up in a cloud's frame, and from what that follows.

A picture that calls itself a plan must be seen from above. Scanners and maps have z up; cameras look along z, with y
down; many clouds follow no convention. So up is looked for in the points: a floor is a plane that holds many points,
few below it and the scanner above it. Where nothing tells, up is not known, and pictures name their views by axes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_MAP = 1e4  # meters east and north from which coordinates are those of a map
_POINTS = 4000  # that are looked at: as they come, so that they must be in an even order
_LEAST = 50
_SLAB = 0.012  # thickness of a floor, of the diagonal of the cloud
_SLACK = 2.0  # thicknesses by which the scanner may lie below a floor: its place is often a guess, and ground slopes
_BELOW = 0.06  # of the points may lie below a floor: reflections, stairs
_FLOOR = 0.1  # of the points lie in a floor
_STEP = 4.0  # degrees between directions that are tried
_LEVEL, _PITCHED = 13.0, 55.0  # degrees between an axis and the normal of the floor: of leveled frames, of cameras
_ROLL = np.sin(np.radians(10.0))  # a camera looks down at a floor, but it is held level
_SNAP = 5.0  # degrees within which the normal of a floor is taken for the nearest axis
_CEILING = 0.5  # of the points of a floor, at most, may lie in a plane above all: it may be the floor as well
_FIELD = np.tan(np.radians(55.0))  # half the widest field of view of a depth camera
_SEEN = 0.9  # of the points of a camera's frame lie in its field of view
_GROUND = 0.25  # of the points lie in the ground around a scanner
_GRAZING, _AROUND = 3.0, 0.7  # its reach over its distance to the scanner; its share of the directions around that
_SECTORS = 24


class Up(NamedTuple):
    """The direction that is up in a frame, (3,) of length 1, or ``None``; and in words what that follows from."""

    direction: NDArray[Any] | None
    reason: str


class _Floor(NamedTuple):
    normal: NDArray[Any]  # (3,) of length 1, upwards
    height: float  # of its points along the normal
    share: float  # of the points
    rows: NDArray[Any]  # (N,) bool: its points


def up_of(points: NDArray[Any], viewpoint: NDArray[Any] | None, origin: NDArray[Any], *, known: bool = False) -> Up:
    """Find out which way is up.

    Args:
        points: (N, 3) meters, relative to ``origin``, spread evenly over the surfaces and in a shuffled order.
        viewpoint: (3,) the place of the scanner, likewise, where it is known or assumed.
        origin: (3,) meters, what the coordinates of the file have besides.
        known: whether the viewpoint is more than a guess.
    """
    z, minus_y = np.array((0.0, 0.0, 1.0)), np.array((0.0, -1.0, 0.0))
    some = points[:_POINTS]
    if min(abs(origin[0]), abs(origin[1])) > _MAP:
        return Up(z, "coordinates of a map")
    if len(some) < _LEAST:
        return Up(None, "too few points")
    below = "" if viewpoint is None else f" below {'the scanner' if known else 'the zero of the frame'}"
    if _floor(some, z, _LEVEL, viewpoint) is not None:
        return Up(z, f"a floor{below}")
    if viewpoint is None:
        return Up(None, "no floor was found")
    if _is_camera(some - viewpoint):
        floor = _floor(some, minus_y, _PITCHED, viewpoint)
        if floor is None or abs(floor.normal[0]) > _ROLL:
            return Up(minus_y, "a camera's frame, y down")
        return Up(_snapped(floor.normal), "the floor before a camera")
    ground = _floor(some, z, 180.0, viewpoint)
    if ground is not None and _is_ground(ground, some, viewpoint):
        return Up(_snapped(ground.normal), f"the ground around and{below}")
    return Up(None, "no floor was found")


def floor_normal(points: NDArray[Any], up: NDArray[Any], viewpoint: NDArray[Any] | None) -> NDArray[Any]:
    """The normal (3,) of the floor, where there is one about across the direction ``up`` (3,); else that direction.

    ``up_of`` takes z for up in a frame that is about level; this is how the floor itself lies. Arguments as there.
    """
    some = points[:_POINTS]
    floor = _floor(some, up, _LEVEL, viewpoint) if len(some) >= _LEAST else None
    return up if floor is None else floor.normal


def upright_frame(up: Up, points: NDArray[Any], viewpoint: NDArray[Any] | None) -> NDArray[Any]:
    """Rotate a frame so that its third axis is up: (3, 3), rows are the new axes; the identity where up is not known.

    The first axis is horizontal, as near as may be to an axis of the frame. Where the scanner stood at one side of all
    it saw, that side is the front: the second axis points away from it.
    """
    if up.direction is None:
        return np.eye(3)
    third = up.direction
    axis = int(np.argmin(np.abs(third)))
    first = np.eye(3)[axis] - third[axis] * third
    first /= np.linalg.norm(first)
    frame = np.stack((first, np.cross(third, first), third))
    if viewpoint is not None and len(points) > 0:
        low, high = np.quantile(points @ frame[:2].T, (0.02, 0.98), axis=0)  # (2,) each
        place = (frame[:2] @ viewpoint - low) / np.maximum(high - low, 1e-12)
        before = np.array((1 - place[1], place[1], 1 - place[0], place[0]))  # seen from -b, b, -a, a: high is outside
        side = int(np.argmax(before))
        if before[side] > 0.9:
            a, b = frame[0], frame[1]
            frame[:2] = np.stack(((a, b), (-a, -b), (-b, a), (b, -a))[side])
    return np.asarray(np.where(np.abs(frame) < 1e-12, 0.0, frame))


def _snapped(normal: NDArray[Any]) -> NDArray[Any]:
    """The nearest axis of the frame, where the normal is close to it, so that pictures keep the axes of the file."""
    number = int(np.argmax(np.abs(normal)))
    axis = np.sign(normal[number]) * np.eye(3)[number]
    return np.asarray(axis if normal @ axis >= np.cos(np.radians(_SNAP)) else normal)


def _is_camera(rays: NDArray[Any]) -> bool:
    """Whether all was seen from before, by a camera that looks along z."""
    inside = (rays[:, 2] > 0) & (np.abs(rays[:, :2]).max(axis=1) < _FIELD * rays[:, 2])
    return bool(inside.mean() > _SEEN)


def _is_ground(floor: _Floor, points: NDArray[Any], viewpoint: NDArray[Any]) -> bool:
    """Whether a plane lies close to the scanner and far around it, as no wall does, and no ceiling like it above."""
    ceiling = _lowest_slab(-points @ floor.normal, _thickness(points))[1]
    if floor.share < _GROUND or ceiling > _CEILING * floor.share:
        return False
    rays = points[floor.rows] - viewpoint
    distance = float(viewpoint @ floor.normal) - floor.height
    flat = rays - (rays @ floor.normal)[:, None] * floor.normal
    first = np.eye(3)[int(np.argmin(np.abs(floor.normal)))]
    angle = np.arctan2(flat @ np.cross(floor.normal, first), flat @ first)
    around = len(np.unique(np.floor(angle / (2 * np.pi) * _SECTORS))) / _SECTORS
    return float(np.median(np.linalg.norm(flat, axis=1))) > _GRAZING * distance and around >= _AROUND


def _floor(points: NDArray[Any], axis: NDArray[Any], reach: float, viewpoint: NDArray[Any] | None) -> _Floor | None:
    """The floor that holds most points, among planes whose normal is within ``reach`` degrees of an axis."""
    thickness = _thickness(points)
    tried = _directions(axis, reach)
    slabs = np.array([_lowest_slab(points @ normal, 4 * thickness) for normal in tried])  # (D, 2)
    above = np.full(len(tried), True) if viewpoint is None else tried @ viewpoint > slabs[:, 0] - _SLACK * thickness
    counts = np.where(above, slabs[:, 1], 0.0)
    best: _Floor | None = None
    for normal in tried[np.argsort(-counts, kind="stable")[:5]]:
        for thick in (4 * thickness, 2 * thickness, thickness):
            height, _ = _lowest_slab(points @ normal, thick)
            rows = np.abs(points @ normal - height) <= thick / 2
            if rows.sum() < _LEAST // 2:
                break
            normal = _normal_of(points[rows], normal)
        else:
            height, count = _lowest_slab(points @ normal, thickness)
            rows = np.abs(points @ normal - height) <= thickness / 2
            near = normal @ axis >= np.cos(np.radians(reach))
            below = viewpoint is None or viewpoint @ normal > height - _SLACK * thickness
            if near and below and (best is None or count > best.share):
                best = _Floor(normal, height, count, rows)
    return None if best is None or best.share < _FLOOR else best


def _thickness(points: NDArray[Any]) -> float:
    low, high = np.quantile(points, (0.01, 0.99), axis=0)
    return _SLAB * max(float(np.linalg.norm(high - low)), 1e-12)


def _lowest_slab(heights: NDArray[Any], thickness: float) -> tuple[float, float]:
    """Middle and share of the fullest slab among those with few points below."""
    order = np.sort(heights)
    ends = np.searchsorted(order, order + thickness, side="right")
    allowed = max(int(_BELOW * len(order)), 1)
    counts = ends[:allowed] - np.arange(allowed)
    first = int(np.argmax(counts))
    return float(order[first] + order[ends[first] - 1]) / 2, float(counts[first]) / len(order)


def _normal_of(points: NDArray[Any], near: NDArray[Any]) -> NDArray[Any]:
    """The normal of the plane through points (N, 3), on the side of ``near``."""
    centered = points - points.mean(axis=0)
    normal = np.linalg.eigh(centered.T @ centered)[1][:, 0]
    return np.asarray(normal if normal @ near >= 0 else -normal)


def _directions(axis: NDArray[Any], reach: float) -> NDArray[Any]:
    """Directions (D, 3) within ``reach`` degrees of an axis, about evenly spread, the axis first."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    second = np.cross(axis, first)
    rings = [axis[None]]
    for ring in range(1, int(reach / _STEP) + 1):
        tilt = np.radians(ring * _STEP)
        turn = np.linspace(0, 2 * np.pi, max(6, round(360 / _STEP * np.sin(tilt))), endpoint=False)[:, None]
        rings.append(np.cos(tilt) * axis + np.sin(tilt) * (np.cos(turn) * first + np.sin(turn) * second))
    return np.concatenate(rings)
