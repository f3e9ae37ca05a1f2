"""A site of known truth: scans, and the true relative poses that an answer is judged by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.types import Clouds


class KnownPair(NamedTuple):
    """Two scans of a site and their true relative pose."""

    source: int
    target: int
    T_target_source: Tensor  # (4, 4) float64, meters


@dataclass(frozen=True, eq=False, kw_only=True)
class TrueSite:
    """One site to measure."""

    name: str  # different for every site
    family: str  # where it is from; tables have a line for each
    scans: int  # a count
    voxel: float  # meters; 6 of them are what a right pose may be off
    read: Callable[[], Readings]


class Readings(NamedTuple):
    """What is read of a site."""

    scans: tuple[Clouds, ...]  # N, each one cloud
    pairs: tuple[KnownPair, ...]  # those by which answers are judged
    T_world_scan: Tensor | None  # (N, 4, 4) float64 where the true poses are known, not only those of pairs


def known_pairs(T_world_scan: Tensor) -> tuple[KnownPair, ...]:
    """All pairs of scans of known poses (N, 4, 4)."""
    inverse = torch.linalg.inv(T_world_scan)
    return tuple(
        KnownPair(source, target, inverse[target] @ T_world_scan[source])
        for source, target in combinations(range(len(T_world_scan)), 2)
    )
