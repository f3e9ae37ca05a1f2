"""The contract of a method: the task it gets, and the answer it returns."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.types import Clouds, Correspondences

INSTALL = "pip install 'torchreg-pointcloud[bench]'"


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """One pair to register.

    Attributes:
        source: one cloud, means over voxels, on the CPU.
        target: likewise.
        voxel: meters, the edge of these voxels, which all lengths follow: normals 2 voxels, descriptors 5, inlier
            threshold 1.5.
        seed: of the random draws.
        device: where torchreg computes; peers use the CPU.
    """

    source: Clouds
    target: Clouds
    voxel: float
    seed: int = 0
    device: str = "cpu"

    @property
    def normal_radius(self) -> float:
        """Meters."""
        return 2 * self.voxel

    @property
    def feature_radius(self) -> float:
        """Meters."""
        return 5 * self.voxel

    @property
    def inlier_threshold(self) -> float:
        """Meters."""
        return 1.5 * self.voxel


class PeerMatches(NamedTuple):
    """Matches of a method, and the clouds whose rows they are."""

    source: Clouds
    target: Clouds
    correspondences: Correspondences


@dataclass(frozen=True, eq=False, kw_only=True)
class Answer:
    """The pose that a method returns.

    Attributes:
        T_target_source: (4, 4) float64 on the CPU, meters, origins included; the identity where there is no pose.
        success: whether the method calls the pair registered.
        matches: on the CPU, what the pose was computed from; ``None`` where the method does not return them.
    """

    T_target_source: Tensor
    success: bool
    matches: PeerMatches | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Method:
    """One way to register a pair.

    Attributes:
        name: on the command line and in files.
        title: in tables.
        statement: how it is run, hypotheses included, in one sentence.
        run: registers the pair of a task; an exception counts as a pair not found.
        module: what it imports beyond torchreg's dependencies, or an empty text.
        package: what pip installs it as.
        slow: takes minutes on an easy pair; quick runs leave it out unless it is named.
    """

    name: str
    title: str
    statement: str
    run: Callable[[Task], Answer]
    module: str = ""
    package: str = ""
    slow: bool = False

    def gap(self) -> str:
        """Why this method cannot be run here, or an empty text."""
        if not self.module:
            return ""
        try:
            importlib.import_module(self.module)
        except ImportError as problem:
            return f"{self.package} cannot be imported ({problem}); {INSTALL}"
        return ""

    def version(self) -> str:
        """The version of its package, or an empty text for a method without one."""
        try:
            return metadata.version(self.package) if self.package else ""
        except metadata.PackageNotFoundError:
            return "unknown"


def with_origins(rotation: Tensor, translation: Tensor, task: Task) -> Tensor:
    """The transform (4, 4) float64 between the clouds' frames, from one between their points less their origins."""
    R, t = rotation.double(), translation.double()
    return rigid(R, t + task.target.origin[0] - apply_rotation(R, task.source.origin[0]))


def no_pose(matches: PeerMatches | None = None) -> Answer:
    """The answer of a method that has no pose."""
    return Answer(T_target_source=torch.eye(4, dtype=torch.float64), success=False, matches=matches)
