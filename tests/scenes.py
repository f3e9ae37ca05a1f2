"""Small scenes whose registration has a known trouble: symmetric, endless, flat, or not the same at all."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from problems import turned
from torch import Tensor

import torchreg as tr

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Center and size, meters."""

ROOM: Box = ((0.0, 0.0, 1.5), (6.0, 4.0, 3.0))
SPACING = 0.1


def boxes(shapes: Sequence[Box], generator: torch.Generator, spacing: float = SPACING) -> Tensor:
    """Points (P, 3) on the surfaces of boxes, one per ``spacing`` squared."""
    parts = []
    for center, size in shapes:
        for axis in range(3):
            u, v = (i for i in range(3) if i != axis)
            for side in (-0.5, 0.5):
                count = max(1, int(size[u] * size[v] / spacing**2))
                face = torch.rand(count, 3, generator=generator) - 0.5
                face[:, axis] = side
                parts.append(face * torch.tensor(size) + torch.tensor(center))
    return torch.cat(parts)


def scan(points: Tensor, viewpoint: Sequence[float], generator: torch.Generator, noise: float = 0.005) -> tr.Clouds:
    """A cloud of these points, voxel means, seen from a place."""
    noisy = points + noise * torch.randn(points.shape, generator=generator)
    cloud = tr.Clouds(points=noisy, viewpoint=torch.tensor([viewpoint], dtype=torch.float32))
    return tr.voxel_downsample(cloud, SPACING)


def moved_pair(
    shapes: Sequence[Box], other: Sequence[Box] | None = None, seed: int = 0
) -> tuple[tr.Clouds, tr.Clouds, Tensor]:
    """Two scans of boxes (or one of each scene), the source moved: source, target, T_target_source (4, 4)."""
    g = torch.Generator().manual_seed(seed)
    target = scan(boxes(shapes if other is None else other, g), (0.4, -0.3, 1.2), g)
    still = scan(boxes(shapes, g), (-0.5, 0.4, 1.4), g)
    T = turned(70.0, translation=(1.0, -2.0, 0.5))
    return tr.transform(still, torch.linalg.inv(T)), target, T


FURNISHED: tuple[Box, ...] = (
    ROOM,
    ((-2.0, 1.2, 0.4), (1.2, 0.8, 0.8)),
    ((1.5, -1.0, 0.9), (0.6, 1.0, 1.8)),
    ((0.3, 1.5, 1.1), (1.4, 0.4, 0.3)),
)
"""A room like no other."""

SYMMETRIC: tuple[Box, ...] = (
    ROOM,
    ((-2.0, 1.2, 0.4), (1.2, 0.8, 0.8)),
    ((2.0, -1.2, 0.4), (1.2, 0.8, 0.8)),
    ((-1.0, -1.3, 1.0), (0.5, 0.7, 2.0)),
    ((1.0, 1.3, 1.0), (0.5, 0.7, 2.0)),
)
"""A room that a half turn about its middle takes onto itself."""

OTHER_ROOM: tuple[Box, ...] = (
    ((0.0, 0.0, 1.3), (4.0, 7.0, 2.6)),
    ((1.0, 2.0, 0.35), (0.9, 1.6, 0.7)),
    ((-1.2, -2.0, 1.0), (0.8, 0.5, 2.0)),
    ((-0.5, 0.5, 0.25), (0.5, 0.5, 0.5)),
)
