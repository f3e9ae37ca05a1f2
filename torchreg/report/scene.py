"""What a picture shows: the points of both clouds in one frame, under one transform or another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import expect, expect_shape
from torchreg.metrics.fit import relative_transform
from torchreg.report.thinning import box, thin
from torchreg.types import Clouds

_FAR = 3.0  # diagonals between two clouds: more, and one picture cannot show both


@dataclass(frozen=True, eq=False)
class Scene:
    """Thinned clouds, ready to be drawn.

    Attributes:
        source: (N, 3) float64, meters, relative to the source's origin.
        target: (M, 3) float64, meters, relative to the target's origin: the frame of the picture.
        colors: (N + M, 3) in [0, 1], source before target, or ``None`` where one of them has none.
        counts: points of source and target before thinning.
        clouds: the clouds themselves.
    """

    source: NDArray[Any]
    target: NDArray[Any]
    colors: NDArray[Any] | None
    counts: tuple[int, int]
    clouds: tuple[Clouds, Clouds]

    def moved(self, T_target_source: Tensor) -> NDArray[Any]:
        """The source (N, 3) in the frame of the picture, under a transform (4, 4), origins included."""
        expect_shape(T_target_source, "T_target_source", (4, 4))
        T = T_target_source.to(device=self.clouds[0].device)[None]
        R, t = relative_transform(*self.clouds, T)
        moved: NDArray[Any] = self.source @ R[0].cpu().numpy().T + t[0].cpu().numpy()
        return moved

    def unmoved(self) -> tuple[NDArray[Any], float]:
        """The source (N, 3) as its file has it, and the meters by which it was brought nearer.

        Zero meters, unless the clouds lie so far from each other that a picture of both would show two dots;
        then the source is drawn about the target's center.
        """
        source, target = self.clouds
        placed = self.source + (source.origin[0] - target.origin[0]).cpu().numpy()
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
        expect(len(cloud) == 1, name, "a batch of one (cloud.select(b) picks one)", f"{len(cloud)} clouds")
    points, colors = [], []
    for cloud in (source, target):
        own = cloud.points.detach().cpu().double().numpy()
        rows = thin(own, count)
        points.append(own[rows])
        if cloud.colors is not None:
            colors.append(np.clip(cloud.colors.detach().cpu().double().numpy()[rows], 0, 1))
    return Scene(
        source=points[0],
        target=points[1],
        colors=np.concatenate(colors) if len(colors) == 2 else None,
        counts=(len(source.points), len(target.points)),
        clouds=(source, target),
    )
