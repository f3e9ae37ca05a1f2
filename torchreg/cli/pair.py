"""The two clouds of a command, and the options that they are registered with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from torch import Tensor

from torchreg.cli.options import INPUT
from torchreg.cli.progress import reading_bar
from torchreg.cli.wording import by_options
from torchreg.io import CLOUD_SUFFIXES, CloudFile, read_cloud_report, read_transform_text
from torchreg.io.formats import alternatives
from torchreg.preprocess import random_downsample, voxel_downsample
from torchreg.registration import derive_options
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.spacing import options_of_spacings, spacing, usable
from torchreg.seeds import generator_of
from torchreg.settings import PRESETS, Settings, StageSettings
from torchreg.types import Clouds

_CLOUD = f"a {alternatives(CLOUD_SUFFIXES)} file, coordinates in meters."


@dataclass(frozen=True, kw_only=True)
class CloudArguments:
    """The files of two clouds."""

    source: Annotated[Path, typer.Argument(metavar="SOURCE", help=f"The cloud that is moved: {_CLOUD}")]
    target: Annotated[Path, typer.Argument(metavar="TARGET", help=f"The cloud that stays: {_CLOUD}")]


@dataclass(frozen=True, kw_only=True)
class PairArguments(CloudArguments):
    """The files of a command that registers two clouds."""

    truth: Annotated[
        Path | None,
        typer.Option(
            "--truth",
            metavar="FILE",
            help="File of the true transform, if it is known: 4x4 as text or JSON, in meters. Adds the errors to the "
            "result: RRE in degrees, RTE (at the origin of the source) and RMSE in meters.",
            rich_help_panel=INPUT,
        ),
    ] = None

    @property
    def paths(self) -> list[Path]:
        """The files that are read."""
        return [path for path in (self.source, self.target, self.truth) if path is not None]

    def transform(self) -> Tensor | None:
        """The true transform (4, 4), where a file of it was given.

        Raises:
            ValueError: the file does not hold one.
        """
        return None if self.truth is None else read_transform_text(self.truth)


@dataclass(frozen=True, eq=False, kw_only=True)
class ReadPair:
    """Source and target, in this order throughout."""

    files: tuple[CloudFile, CloudFile]  # what reading them showed
    whole: tuple[Clouds, Clouds]  # all points of the files
    used: tuple[Clouds, Clouds]  # the points to be registered

    @property
    def words(self) -> tuple[str, str]:
        """File name and size of both."""
        texts = []
        for file, cloud in zip(self.files, self.used, strict=True):
            used = len(cloud.points)
            part = "" if used == file.points_in_file else f"{used:,} of "
            texts.append(f"{file.path}: {part}{file.points_in_file:,} points")
        return texts[0], texts[1]

    def notes(self) -> dict[str, list[str]]:
        """What reading showed, for JSON."""
        names = zip(("source", "target"), self.files, strict=True)
        return {name: [by_options(note) for note in file.notes] for name, file in names}

    def sided_notes(self) -> list[str]:
        """What reading showed, each note with the side it is of."""
        return [f"{side}: {note}" for side, notes in self.notes().items() for note in notes]

    def counts(self) -> dict[str, dict[str, int]]:
        """Points in the files and points used, for JSON."""
        numbers = zip(("source", "target"), self.files, self.used, strict=True)
        return {name: {"in_file": file.points_in_file, "used": len(used.points)} for name, file, used in numbers}


def read_pair(paths: CloudArguments, settings: StageSettings) -> ReadPair:
    """Read both files, and choose some points of each at random where that is asked for.

    Raises:
        CloudFileError: a file that cannot be read as a cloud.
        ValueError: the viewpoint cannot be meant.
    """
    reading, files = settings.reading(), []
    for path, scan in zip((paths.source, paths.target), settings.scans(), strict=True):
        with reading_bar(path.name) as progress:
            files.append(read_cloud_report(path, scan=scan, reading=reading, progress=progress))
    whole = (files[0].cloud, files[1].cloud)
    used = whole
    if settings.points is not None:
        generator = generator_of(settings.seed)
        used = (
            random_downsample(whole[0], settings.points, generator=generator),
            random_downsample(whole[1], settings.points, generator=generator),
        )
    return ReadPair(files=(files[0], files[1]), whole=whole, used=used)


def options_of_pair(source: Clouds, target: Clouds, settings: StageSettings) -> RegistrationOptions:
    """Options for one pair: a preset's, or derived from the spacing of the points once they are downsampled.

    A voxel size given with the default preset thus sets the scale of all lengths that are not given.
    """
    preset = PRESETS[settings.preset]
    if preset is not None:
        return settings.over(preset)
    effort = (settings.effort if isinstance(settings, Settings) else None) or "balanced"
    if settings.voxel is None or not (usable(source) and usable(target)):
        return settings.over(derive_options(source, target, effort=effort)[0])
    thinned = [voxel_downsample(cloud, settings.voxel) for cloud in (source, target)]
    apart = (float(spacing(thinned[0])), float(spacing(thinned[1])))
    colored = source.colors is not None and target.colors is not None
    return settings.over(options_of_spacings(apart, settings.voxel, colored=colored, effort=effort))
