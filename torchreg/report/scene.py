"""What a picture shows: points of both clouds, thinned, in one upright frame, under one transform or another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import expect_in_words, expect_shape
from torchreg.geometry.up import Up, up_of, upright_frame
from torchreg.metrics.fit import relative_transform
from torchreg.types import Clouds

Box = tuple[NDArray[Any], NDArray[Any]]
"""The lowest and the highest corner, (D,) each."""

_FAR = 3.0  # diagonals between two clouds: more, and one picture cannot show both
_SEED = 0
_CELLS = 400  # along the longest edge: about the pixels of one panel
_FEW = 1000


@dataclass(frozen=True, eq=False)
class Scene:
    """Two thinned clouds, and the frame of a picture: the target's, turned so that its third axis is up."""

    source: NDArray[Any]  # (N, 3) float64, meters, relative to the source's origin, in the source's frame
    target: NDArray[Any]  # (M, 3) float64, meters, relative to the target's origin, in the picture's frame
    frame: NDArray[Any]  # (3, 3), a rotation: its rows are the picture's axes in the target's frame
    up: Up  # in the target's frame
    colors: NDArray[Any] | None  # (N + M, 3) in [0, 1], source before target, ``None`` where one has none or one alone
    counts: tuple[int, int]  # points of source and target before thinning
    clouds: tuple[Clouds, Clouds]  # whole, source before target

    def moved(self, T_target_source: Tensor, points: NDArray[Any] | None = None) -> NDArray[Any]:
        """The source, or other points (N, 3) in its frame, under a transform (4, 4), origins included.

        Returns:
            (N, 3) in the picture's frame.
        """
        expect_shape(T_target_source, "T_target_source", (4, 4))
        T = T_target_source.to(device=self.clouds[0].device)[None]
        R, t = relative_transform(*self.clouds, T)
        before = self.source if points is None else points
        return self.turned(before @ R[0].cpu().numpy().T + t[0].cpu().numpy())

    def turned(self, points: NDArray[Any]) -> NDArray[Any]:
        """Points (N, 3) of the target's frame in the picture's frame."""
        turned: NDArray[Any] = points @ self.frame.T
        return turned

    def unmoved(self) -> tuple[NDArray[Any], float]:
        """The source (N, 3) by the numbers of its file, in the picture's frame, and by how many meters it was moved.

        Zero meters, unless the clouds lie so far from each other that a picture of both would show two dots;
        then the source is drawn about the target's center.
        """
        source, target = self.clouds
        placed = self.turned(self.source + (source.origin[0] - target.origin[0]).cpu().numpy())
        if len(placed) == 0 or len(self.target) == 0:
            return placed, 0.0
        corners = [box(placed), box(self.target)]
        apart = sum(corners[0]) / 2 - sum(corners[1]) / 2
        size = max(float(np.linalg.norm(high - low)) for low, high in corners)
        distance = float(np.linalg.norm(apart))
        return (placed, 0.0) if distance <= _FAR * size else (placed - apart, distance)


def scene_of(source: Clouds, target: Clouds, count: int) -> Scene:
    """Thin two clouds to at most ``count`` points each for a picture.

    Raises:
        ValueError: a batch of several clouds.
    """
    for name, cloud in (("source", source), ("target", target)):
        expect_in_words(len(cloud) == 1, name, "a batch of one (cloud[b] picks one)", f"{len(cloud)} clouds")
    points, colors = [], []
    for cloud in (source, target):
        all_points = cloud.points.detach().cpu().double().numpy()
        rows = thin(all_points, count)
        points.append(all_points[rows])
        if cloud.colors is not None and _is_colorful(cloud.colors):
            colors.append(np.clip(cloud.colors.detach().cpu().double().numpy()[rows], 0, 1))
    place = None if target.viewpoint is None else target.viewpoint[0].detach().cpu().double().numpy()
    place = None if place is None or not np.isfinite(place).all() else place
    up = up_of(points[1], place, target.origin[0].cpu().numpy(), known=bool(target.viewpoint_known[0]))
    frame = upright_frame(up, points[1], place)
    return Scene(
        source=points[0],
        target=points[1] @ frame.T,
        frame=frame,
        up=up,
        colors=np.concatenate(colors) if len(colors) == 2 else None,
        counts=(len(source.points), len(target.points)),
        clouds=(source, target),
    )


def _is_colorful(colors: Tensor) -> bool:
    """Whether colors (P, 3) are more than one: a file whose points all have one color has none to show."""
    return bool((colors != colors[:1]).any())


def thin(points: NDArray[Any], count: int) -> NDArray[np.int64]:
    """Rows of at most ``count`` finite points, spread over the space that they fill, in a shuffled order.

    A scanner puts most points right beside itself, so a plain random choice would leave the far walls empty:
    every small cube gives one point before any gives a second.

    Args:
        points: (N, 3).
        count: how many stay.

    Returns:
        (K,) int64, K <= count. The order is shuffled, so its first part is as even as the whole.
    """
    order = np.random.default_rng(_SEED).permutation(np.flatnonzero(np.isfinite(points).all(axis=1)))
    if len(order) <= count:
        return order
    low, high = box(points[order])
    edge = max(float((high - low).max()), 1e-12) / _CELLS
    cell = np.clip((points[order] - low) / edge, -_CELLS, 2 * _CELLS).astype(np.int64) + _CELLS  # (N, 3)
    key = (cell[:, 0] * 4 * _CELLS + cell[:, 1]) * 4 * _CELLS + cell[:, 2]
    first = np.zeros(len(order), dtype=bool)
    first[np.unique(key, return_index=True)[1]] = True
    return np.concatenate((order[first], order[~first]))[:count]


def box(points: NDArray[Any]) -> Box:
    """What most points (N, D) fill: a few stray ones do not count."""
    if len(points) == 0:
        return np.zeros(points.shape[1]), np.ones(points.shape[1])
    if len(points) < _FEW:
        return points.min(axis=0), points.max(axis=0)
    low, high = np.quantile(points, (0.002, 0.998), axis=0)
    return low, high


def padded(corners: Box, margin: float) -> Box:
    """The box with a margin all around, a share of its longest edge."""
    low, high = corners
    pad = max(margin * float((high - low).max()), 1e-6)
    return low - pad, high + pad


def union(one: Box, other: Box) -> Box:
    """The least box that holds both."""
    return np.minimum(one[0], other[0]), np.maximum(one[1], other[1])
