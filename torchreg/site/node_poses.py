"""Poses of scans in the frames of their groups as poses of a graph's nodes, whose frames are moved, and back."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, compose, rigid
from torchreg.site.graph import SiteGraph
from torchreg.site.optimize import SettledPoses
from torchreg.site.placement import Placement


class PlacedPoses(NamedTuple):
    """Poses of all scans, NaN where not placed."""

    T_world_scan: Tensor  # (N, 4, 4)
    covariance: Tensor  # (N, 6, 6) of a small turn about ``center`` and a shift, in the frame of the group
    center: Tensor  # (N, 3)
    scale: float


def entered(graph: SiteGraph, placement: Placement, T_world_scan: Tensor) -> tuple[Tensor, Tensor]:
    """Poses of scans as poses of the graph's nodes (N + 1, 4, 4), and which of these stay (N + 1,)."""
    count = len(placement)
    eye = torch.eye(3, dtype=torch.float64)
    poses = torch.eye(4, dtype=torch.float64).repeat(count + 1, 1, 1)
    fixed = torch.ones(count + 1, dtype=torch.bool)
    placed = (placement.group >= 0).nonzero()[:, 0]
    world = torch.where(placement.in_world[:, None], graph.zero[-1], 0.0)
    at = compose(T_world_scan, rigid(eye.expand(count, 3, 3), graph.zero[:-1]))
    at[:, :3, 3] -= world
    poses[placed], fixed[placed] = at[placed], False
    first: dict[int, int] = {}
    for scan in placed.tolist():
        if not bool(placement.in_world[scan]):
            first.setdefault(int(placement.group[scan]), scan)
    fixed[list(first.values())] = True
    return poses, fixed


def left(graph: SiteGraph, placement: Placement, settled: SettledPoses) -> PlacedPoses:
    """Poses of the nodes as those of the scans."""
    count = len(placement)
    poses = settled.poses[:count]
    R = poses[:, :3, :3]
    center = poses[:, :3, 3] + torch.where(placement.in_world[:, None], graph.zero[-1], 0.0)
    T = rigid(R, center - apply_rotation(R, graph.zero[:count]))
    both = torch.zeros(count, 6, 6, dtype=torch.float64)
    both[:, :3, :3] = both[:, 3:, 3:] = R
    nothing = torch.where(placement.group >= 0, 0.0, torch.nan)[:, None]
    covariance = both @ settled.covariance[:count] @ both.transpose(1, 2)
    return PlacedPoses(T + nothing[:, None], covariance + nothing[:, None], center + nothing, settled.scale)
