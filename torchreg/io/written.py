"""The arrays of one cloud as writers need them: in the frame of the file, and as precise as it takes."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.errors import expect_in_words
from torchreg.io.placement import FAR_COORDINATE
from torchreg.types import Clouds


def narrowest(cloud: Clouds) -> Clouds:
    """The cloud in single precision where its coordinates have no more digits, so that files do not grow."""
    narrow = cloud.to(dtype=torch.float32)
    return narrow if torch.equal(narrow.points.double(), cloud.points) else cloud


def global_points(cloud: Clouds) -> NDArray[Any]:
    """The points (N, 3) float64 in the frame of the file: the origin added."""
    points: NDArray[Any] = (cloud.points + cloud.origin).detach().numpy()
    return points


def is_far(cloud: Clouds, points: NDArray[Any]) -> bool:
    """Whether the points (N, 3) lie so far from zero that floats of four bytes would lose what a survey measures."""
    return bool(cloud.origin.any()) or (len(points) > 0 and float(np.abs(points).max()) > FAR_COORDINATE)


def needs_doubles(cloud: Clouds, points: NDArray[Any], dtype: torch.dtype) -> bool:
    """Whether floats of four bytes would lose any digit of the points (N, 3), which the caller has in ``dtype``."""
    return dtype == torch.float64 or is_far(cloud, points)


def color_levels(cloud: Clouds, brightest: int) -> NDArray[Any] | None:
    """The colors (N, 3) as whole numbers from 0 to ``brightest``, in float64; ``None`` without colors."""
    if cloud.colors is None:
        return None
    levels: NDArray[Any] = np.round(np.clip(cloud.colors.detach().numpy(), 0, 1) * brightest)
    return levels


def normals_of(cloud: Clouds) -> NDArray[Any] | None:
    """The normals (N, 3) in float64, or ``None``."""
    return None if cloud.normals is None else cloud.normals.detach().numpy()


def expect_finite(points: NDArray[Any], kind: str) -> None:
    """Raise ``ValueError`` for points that a format cannot hold."""
    expect_in_words(bool(np.isfinite(points).all()), "cloud", f"finite points, as {kind} holds them", "NaN or infinity")
