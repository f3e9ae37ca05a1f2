"""Scans of flat faces with noise, and their surfels: what poses are refined on."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from problems import seeded
from scenes import FURNISHED, Box, boxes
from torch import Tensor

import torchreg as tr
from torchreg.refinement.surfels import Surfels, surfels_of

Face = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
"""A corner and two edges, meters."""

FLOOR: Face = ((-10.0, -1.5, 0.0), (20.0, 0.0, 0.0), (0.0, 3.0, 0.0))
CORRIDOR: tuple[Face, ...] = (
    FLOOR,
    ((-10.0, -1.5, 0.0), (20.0, 0.0, 0.0), (0.0, 0.0, 2.5)),
    ((-10.0, 1.5, 0.0), (20.0, 0.0, 0.0), (0.0, 0.0, 2.5)),
)
"""Two walls and a floor, along x."""

NOISE = 0.005
REACH = 0.15


def faces(shapes: Sequence[Face], generator: torch.Generator, spacing: float = 0.1) -> Tensor:
    """Points (P, 3) float32 on faces, one per ``spacing`` squared."""
    parts = []
    for corner, *edges in shapes:
        corner, first, second = (torch.tensor(each) for each in (corner, *edges))
        count = int(torch.linalg.cross(first, second).norm() / spacing**2)
        u, v = torch.rand(2, count, 1, generator=generator)
        parts.append(corner + u * first + v * second)
    return torch.cat(parts)


def two_scans(
    draw: Callable[[torch.Generator], Tensor], T_target_source: Tensor, *, noise: float = NOISE, seed: int = 0
) -> tuple[tr.Clouds, tr.Clouds]:
    """Two clouds of what ``draw`` gives for a generator, points of their own each, with noise; the source moved."""
    g = seeded(seed)
    still, target = (_noisy(draw(g), noise, g) for _ in range(2))
    return tr.transform(still, torch.linalg.inv(T_target_source)), target


def two_rooms(
    T_target_source: Tensor,
    *,
    shapes: Sequence[Box] = FURNISHED,
    noise: float = NOISE,
    spacing: float = 0.1,
    seed: int = 0,
) -> tuple[tr.Clouds, tr.Clouds]:
    """Two scans of boxes."""
    return two_scans(lambda g: boxes(shapes, g, spacing), T_target_source, noise=noise, seed=seed)


def surfels_of_both(pair: tuple[tr.Clouds, tr.Clouds], count: int = 3000) -> tuple[Surfels, Surfels]:
    return surfels_of(pair[0], count), surfels_of(pair[1], count)


def off_by(T: Tensor, T_true: Tensor, points: Tensor) -> float:
    """Meters, the most that any of the source's points (P, 3) stands off under T (4, 4) from where it should."""
    apart = T - T_true
    return float((points.double() @ apart[:3, :3].T + apart[:3, 3]).norm(dim=1).max())


def _noisy(points: Tensor, noise: float, generator: torch.Generator) -> tr.Clouds:
    return tr.Clouds(points=(points + noise * torch.randn(points.shape, generator=generator)).double())
