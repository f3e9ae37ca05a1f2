"""Geometry of painted quads, and the solids made of them.

Everything in a scene is quads, boxes, cylinders and balls included: one array to build, move and cast rays
at. ``N`` solids are made at once. The unit is the meter, z is up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.paint import Paint


@dataclass(frozen=True, eq=False)
class Quads:
    """``Q`` painted quads."""

    corners: Array  # (Q, 4, 3) float64, meters, in turn; a corner given twice makes a triangle
    uv: Array  # (Q, 4, 2) float64, meters, the texture coordinates of the corners
    paint: Paint  # Q rows

    def __len__(self) -> int:
        """The number of quads."""
        return len(self.corners)

    def placed(self, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Quads:
        """These quads turned by ``yaw`` radians about the z axis, then shifted by (x, y, z) meters."""
        corners = self.corners @ yaw_rotation(np.array([yaw]))[0].T
        return replace(self, corners=corners + np.array([x, y, z]))

    @staticmethod
    def join(parts: Sequence[Quads]) -> Quads:
        """All quads of the parts."""
        return Quads(
            np.concatenate([part.corners for part in parts]),
            np.concatenate([part.uv for part in parts]),
            Paint.join([part.paint for part in parts]),
        )


def rectangles(center: npt.ArrayLike, edge_u: npt.ArrayLike, edge_v: npt.ArrayLike, paint: Paint) -> Quads:
    """``N`` rectangles from their centers and full edge vectors, each (N, 3) or (3,)."""
    shape = (len(paint), 3)
    middle, across, along = (np.broadcast_to(value, shape) for value in (center, edge_u, edge_v))
    half = 0.5 * _RING  # (4, 2)
    corners = middle[:, None] + half[:, :1] * across[:, None] + half[:, 1:] * along[:, None]  # (N, 4, 3)
    lengths = np.stack((np.linalg.norm(across, axis=1), np.linalg.norm(along, axis=1)), axis=1)
    return Quads(corners, half * lengths[:, None], paint)


def boxes(center: npt.ArrayLike, size: npt.ArrayLike, paint: Paint, yaw: npt.ArrayLike = 0.0) -> Quads:
    """``N`` boxes from their centers and full sizes, each (N, 3) or (3,), and yaw (N,) in radians."""
    count = len(paint)
    center, size = np.broadcast_to(center, (count, 3)), np.broadcast_to(size, (count, 3))
    local = _BOX * size[:, None, None]  # (N, 6, 4, 3)
    rotation = yaw_rotation(np.broadcast_to(yaw, (count,)))
    corners = np.einsum("nij,nfcj->nfci", rotation, local) + center[:, None, None]
    lengths = np.stack((np.abs(size @ _BOX_U.T), np.abs(size @ _BOX_V.T)), axis=2)  # (N, 6, 2)
    uv = 0.5 * _RING * lengths[:, :, None]  # (N, 6, 4, 2)
    painted = paint.take(np.repeat(np.arange(count), 6))
    painted = replace(painted, key=painted.key + np.tile(np.arange(6), count))  # no two faces alike
    return Quads(corners.reshape(-1, 4, 3), uv.reshape(-1, 4, 2), painted)


def cylinders(
    base: npt.ArrayLike, radius: npt.ArrayLike, height: npt.ArrayLike, paint: Paint, sides: int = 32
) -> Quads:
    """``N`` closed upright cylinders from the centers of their bases (N, 3), radii and heights (N,)."""
    count = len(paint)
    base = np.broadcast_to(base, (count, 3))[:, None]
    radius, height = np.broadcast_to(radius, (count,)), np.broadcast_to(height, (count,))
    angle = np.linspace(-np.pi, np.pi, sides + 1)
    rim = np.zeros((count, sides + 1, 3))
    rim[..., 0], rim[..., 1] = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    up = np.zeros((count, 1, 3))
    up[:, 0, 2] = height
    low, high = base + rim, base + rim + up
    top, bottom = np.broadcast_to(base + up, low[:, 1:].shape), np.broadcast_to(base, low[:, 1:].shape)
    corners = np.concatenate(
        (
            np.stack((low[:, :-1], low[:, 1:], high[:, 1:], high[:, :-1]), axis=2),
            np.stack((top, high[:, :-1], high[:, 1:], high[:, 1:]), axis=2),
            np.stack((bottom, low[:, 1:], low[:, :-1], low[:, :-1]), axis=2),
        ),
        axis=1,
    )  # (N, 3 * sides, 4, 3)
    uv = (corners - base[:, None])[..., :2].copy()  # right for the caps; the mantle is unrolled
    around = angle[_STEP[:, 0] + np.arange(sides)[:, None]]  # (sides, 4)
    uv[:, :sides, :, 0] = radius[:, None, None] * around
    uv[:, :sides, :, 1] = height[:, None, None] * (_STEP[:, 1] - 0.5)
    painted = paint.take(np.repeat(np.arange(count), 3 * sides))
    return Quads(corners.reshape(-1, 4, 3), uv.reshape(-1, 4, 2), painted)


def balls(center: npt.ArrayLike, radii: npt.ArrayLike, paint: Paint, sides: int = 16) -> Quads:
    """``N`` ellipsoids from their centers and half axes, each (N, 3) or (3,)."""
    count, rows = len(paint), sides // 2
    center, radii = np.broadcast_to(center, (count, 3)), np.broadcast_to(radii, (count, 3))
    longitude = np.linspace(-np.pi, np.pi, sides + 1)
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rows + 1)[:, None]
    flat = np.cos(latitude)
    height = np.sin(latitude) + 0 * longitude
    unit = np.stack((flat * np.cos(longitude), flat * np.sin(longitude), height), -1)
    angles = np.stack((longitude + 0 * latitude, latitude + 0 * longitude), -1)  # (rows + 1, sides + 1, 2)
    i, j = (grid.reshape(-1, 1) for grid in np.meshgrid(np.arange(rows), np.arange(sides), indexing="ij"))
    i, j = i + _STEP[:, 1], j + _STEP[:, 0]  # (rows * sides, 4)
    corners = center[:, None, None] + radii[:, None, None] * unit[i, j]
    uv = radii.mean(axis=1)[:, None, None, None] * angles[i, j]
    painted = paint.take(np.repeat(np.arange(count), rows * sides))
    return Quads(corners.reshape(-1, 4, 3), uv.reshape(-1, 4, 2), painted)


def prism(profile: npt.ArrayLike, width: float, paint: Paint) -> Quads:
    """A convex profile (K, 2) in the xz plane, meters, drawn out along y to ``width`` about the plane; one paint."""
    side = np.insert(np.asarray(profile, dtype=np.float64), 1, 0.0, axis=1)  # (K, 3)
    half = np.array([0.0, width / 2, 0.0])
    near, far = side - half, side + half
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.roll(side, -1, axis=0) - side, axis=1))))  # (K + 1,)
    around = np.stack((near, np.roll(near, -1, axis=0), np.roll(far, -1, axis=0), far), axis=1)
    across = np.broadcast_to((-width / 2, -width / 2, width / 2, width / 2), (len(side), 4))
    around_uv = np.stack((np.stack((along[:-1], along[1:], along[1:], along[:-1]), axis=1), across), axis=2)
    fan = np.array([(0, k, k + 1, k + 1) for k in range(1, len(side) - 1)])
    corners = np.concatenate((around, near[fan], far[fan]))  # (3K - 4, 4, 3)
    uv = np.concatenate((around_uv, side[fan][..., [0, 2]], side[fan][..., [0, 2]]))
    return Quads(corners, uv, paint.take(np.zeros(len(corners), dtype=np.int64)))


def polygon(radius: float, sides: int = 16, turn: float = 0.0) -> Array:
    """A regular polygon (sides, 2) about the origin; ``turn`` is the angle of its first corner, radians."""
    angle = turn + 2 * np.pi * np.arange(sides) / sides
    return radius * np.stack((np.cos(angle), np.sin(angle)), axis=1)


def at_height(x: npt.ArrayLike, y: npt.ArrayLike, z: float) -> Array:
    """Places (N, 3) at one height; ``x`` and ``y`` are (N,) or one number."""
    x, y = np.broadcast_arrays(x, y)
    return np.stack((x, y, np.full(x.shape, z)), axis=-1)


def up(height: float) -> Array:
    """The vector (3,) of this many meters upwards."""
    return np.array([0.0, 0.0, height])


def yaw_rotation(yaw: Array) -> Array:
    """Rotations (N, 3, 3) about the z axis by ``yaw`` (N,) radians."""
    cosine, sine, zero = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    rows = (cosine, -sine, zero, sine, cosine, zero, zero, zero, zero + 1)
    return np.stack(rows, axis=-1).reshape(-1, 3, 3)


_RING = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float64)
_STEP = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
_BOX_U = np.array([[0, 1, 0], [0, -1, 0], [-1, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0]], dtype=np.float64)
_BOX_V = np.array([[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 1, 0], [0, -1, 0]], dtype=np.float64)
_BOX = 0.5 * (
    np.cross(_BOX_U, _BOX_V)[:, None] + _RING[:, :1] * _BOX_U[:, None] + _RING[:, 1:] * _BOX_V[:, None]
)  # (6 faces, 4 corners, 3)
