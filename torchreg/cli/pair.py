"""The two clouds of a command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from torchreg.cli import options as opt
from torchreg.cli.progress import step
from torchreg.io import CloudFile, read_cloud_report
from torchreg.io.placement import viewpoint_of_text
from torchreg.preprocess import random_downsample
from torchreg.types import Clouds


@dataclass(frozen=True, kw_only=True)
class PairInput:
    """What a command on two clouds reads, and how."""

    source: opt.Source
    target: opt.Target
    points: opt.Points = None
    viewpoint: opt.ViewpointText = "auto"
    truth: opt.TruthFile = None
    seed: opt.Seed = 0

    @property
    def paths(self) -> list[Path]:
        """The files that are read."""
        return [path for path in (self.source, self.target, self.truth) if path is not None]

    def run(self) -> dict[str, object]:
        """How the clouds were read, for JSON."""
        return {"points": self.points, "viewpoint": self.viewpoint}

    def transform(self) -> Tensor | None:
        """The true transform (4, 4), where a file of it was given.

        Raises:
            ValueError: the file does not hold one.
        """
        from torchreg.io import read_transform_text

        return None if self.truth is None else read_transform_text(self.truth)


@dataclass(frozen=True, eq=False, kw_only=True)
class ReadPair:
    """Source and target, in this order throughout.

    Attributes:
        files: what reading them showed.
        whole: all points of the files.
        used: the points to be registered.
    """

    files: tuple[CloudFile, CloudFile]
    whole: tuple[Clouds, Clouds]
    used: tuple[Clouds, Clouds]

    @property
    def words(self) -> tuple[str, str]:
        """File name and size of both."""
        return self._said(0), self._said(1)

    @property
    def colored(self) -> bool:
        """Whether both have colors."""
        return all(file.has_colors for file in self.files)

    def counts(self) -> dict[str, dict[str, int]]:
        """Points in the files and points used, for JSON."""
        numbers = zip(("source", "target"), self.files, self.used, strict=True)
        return {name: {"in_file": file.points_in_file, "used": len(used.points)} for name, file, used in numbers}

    def _said(self, which: int) -> str:
        file, used = self.files[which], len(self.used[which].points)
        part = "" if used == file.points_in_file else f"{used:,} of "
        return f"{file.path}: {part}{file.points_in_file:,} points"


def read_pair(words: PairInput) -> ReadPair:
    """Read both files, and choose some points of each at random where that is asked for.

    Raises:
        CloudFileError: a file that cannot be read as a cloud.
        ValueError: the viewpoint means nothing.
    """
    position = viewpoint_of_text(words.viewpoint, "--viewpoint")
    files = []
    for path in (words.source, words.target):
        with step(f"reading {path.name}"):
            files.append(read_cloud_report(path, viewpoint=position))
    whole = (files[0].cloud, files[1].cloud)
    used = whole
    if words.points is not None:
        generator = torch.Generator().manual_seed(words.seed)
        used = (
            random_downsample(whole[0], words.points, generator=generator),
            random_downsample(whole[1], words.points, generator=generator),
        )
    return ReadPair(files=(files[0], files[1]), whole=whole, used=used)
