"""What a method gets, and what it must answer."""

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
        device: where a method computes that can compute elsewhere than on the CPU.
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


class Matched(NamedTuple):
    """Matches, and the clouds whose rows they name."""

    source: Clouds
    target: Clouds
    correspondences: Correspondences


@dataclass(frozen=True, eq=False, kw_only=True)
class Answer:
    """What a method found.

    Attributes:
        T_target_source: (4, 4) float64 on the CPU, meters, origins included; the identity where it found nothing.
        success: whether the method itself calls the pair registered.
        matches: on the CPU, what the pose was found from; ``None`` where the method does not tell.
    """

    T_target_source: Tensor
    success: bool
    matches: Matched | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Method:
    """One way to register a pair.

    Attributes:
        name: on the command line and in files.
        title: in tables.
        statement: how it is run, hypotheses included, in a sentence.
        run: answers a task; an exception is counted as a pair not found.
        module: what it imports beyond this library's own dependencies, or an empty text.
        package: the name under which pip knows that.
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
        """The version of its package, or an empty text for what has none of its own."""
        try:
            return metadata.version(self.package) if self.package else ""
        except metadata.PackageNotFoundError:
            return "unknown"


def with_origins(rotation: Tensor, translation: Tensor, task: Task) -> Tensor:
    """The transform (4, 4) float64 between the clouds' frames, from one between their points less their origins."""
    R, t = rotation.double(), translation.double()
    return rigid(R, t + task.target.origin[0] - apply_rotation(R, task.source.origin[0]))


def nothing_found(matches: Matched | None = None) -> Answer:
    """The answer where there is no pose."""
    return Answer(T_target_source=torch.eye(4, dtype=torch.float64), success=False, matches=matches)
