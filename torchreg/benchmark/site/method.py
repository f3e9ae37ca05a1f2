"""The contract of a method that places the scans of a site."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.types import Clouds


@dataclass(frozen=True, eq=False, kw_only=True)
class SiteTask:
    """One site to place."""

    scans: tuple[Clouds, ...]  # N, each one cloud
    voxel: float  # meters, about the spacing that the scans should be compared at
    seed: int = 0  # of the random draws


@dataclass(frozen=True, eq=False, kw_only=True)
class SiteAnswer:
    """Where a method puts the scans."""

    T_world_scan: Tensor  # (N, 4, 4) float64, meters; of any value where not placed
    group: Tensor  # (N,) int64, -1 where not placed; poses of different groups have nothing to do with each other
    pairs_tried: int  # of the N (N - 1) / 2


@dataclass(frozen=True, eq=False, kw_only=True)
class SiteMethod:
    """One way to place the scans of a site."""

    name: str  # on the command line and in files
    title: str  # in tables
    statement: str  # how it is run, in one sentence
    run: Callable[[SiteTask], SiteAnswer]  # an exception counts as no scan placed
    slow: bool = False  # quick runs leave it out unless it is named


def along_tree(count: int, links: Iterable[tuple[int, int, Tensor]]) -> SiteAnswer:
    """Poses along a tree: each link, in order, joins two groups of scans that do not hang together yet.

    Args:
        count: of scans.
        links: source, target and T_target_source (4, 4), the surest first.

    Returns:
        The poses, and as groups what hangs together; a scan alone is not placed. No pair counts as tried.
    """
    T_world_scan = torch.eye(4, dtype=torch.float64).repeat(count, 1, 1)
    of = torch.arange(count)
    for source, target, T_target_source in links:
        if of[source] != of[target]:
            moved = of == of[source]
            T = T_world_scan[target] @ T_target_source @ torch.linalg.inv(T_world_scan[source])
            T_world_scan[moved] = T @ T_world_scan[moved]
            of[moved] = of[target].clone()
    return SiteAnswer(T_world_scan=T_world_scan, group=numbered(of.tolist()), pairs_tried=0)


def numbered(labels: Sequence[int]) -> Tensor:
    """Groups (N,) of scans of equal labels, the largest first; -1 for a scan alone."""
    sizes = {label: labels.count(label) for label in labels}
    order = sorted((label for label in sizes if sizes[label] > 1), key=lambda label: (-sizes[label], label))
    return torch.tensor([order.index(label) if sizes[label] > 1 else -1 for label in labels])
