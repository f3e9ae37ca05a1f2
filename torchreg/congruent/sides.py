"""One cloud as bases and pairs are searched in: points about their middle, with what tells them apart."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.types import Clouds


class CloudSide(NamedTuple):
    """N points of one cloud."""

    points: Tensor  # (3, N) float32, meters, about ``center``
    normals: Tensor | None  # (3, N) float32 of unit length, or ``None``
    colors: Tensor | None  # (3, N) float32 in [0, 1], or ``None``
    center: Tensor  # (3,) float64, meters, in the frame of the points


class Tolerances(NamedTuple):
    """By how much what belongs together may differ."""

    meters: float  # lengths, crossings and points
    normals: float  # radians between two normals; pi leaves them out
    colors: float  # distance of two colors; infinite leaves them out
    signed: bool  # whether the sides of surfaces are known, else normals may be reversed


def side_of(cloud: Clouds) -> CloudSide:
    """One cloud, a batch of one with at least one point."""
    wide = cloud.points.double()
    center = (wide.amin(dim=0) + wide.amax(dim=0)) / 2
    return CloudSide(
        points=(wide - center).float().t().contiguous(),
        normals=None if cloud.normals is None else cloud.normals.float().t().contiguous(),
        colors=None if cloud.colors is None else cloud.colors.float().t().contiguous(),
        center=center,
    )


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Over the first dimension, one term after another."""
    x, y, z = (a * b).unbind(0)
    return x + y + z


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Of vectors (3, ...)."""
    return a.roll(-1, 0) * b.roll(-2, 0) - a.roll(-2, 0) * b.roll(-1, 0)


def unit(vectors: Tensor) -> Tensor:
    """Of length one, or zero, (3, ...)."""
    length = dot(vectors, vectors).sqrt()
    return vectors / torch.where(length > 0, length, torch.ones_like(length))


def diameter(side: CloudSide) -> float:
    """Meters, of the bounding box."""
    extent = (side.points.amax(dim=1) - side.points.amin(dim=1)).double()
    return math.sqrt(float(dot(extent, extent)))
