"""The options of ``torchreg site`` that say which frame the scans are wanted in."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import typer

from torchreg.errors import expect, expect_in_words, positive
from torchreg.io.atomic import write_text
from torchreg.io.csv_cells import cell_of_text
from torchreg.io.poses_csv import check_poses_csv, read_poses_csv
from torchreg.io.scan_table import scan_number
from torchreg.site.control import JudgedPoint, check_control_points, read_control_points
from torchreg.site.frame import SiteFrame

OF_FILES = "files"
"""The word for the poses that files hold, which are applied when they are read."""

_PANEL = "Frame"
_RESIDUALS = ("name", "scan", "X", "Y", "Z", "meters", "suspicious")


@dataclass(frozen=True, kw_only=True)
class HowToFrame:
    """What is known of the frame."""

    fix: Annotated[
        str | None,
        typer.Option(
            "--fix",
            metavar="SCAN",
            help="The scan that stays where it is, by the name of its file or its own name in a file of several, or by "
            "its number (from 0): in the frame of its file, or "
            "at the pose that --poses gives it.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    poses: Annotated[
        str | None,
        typer.Option(
            "--poses",
            metavar="FILE.csv",
            help="Poses that are known beforehand: a table like poses.csv, in meters, or the word files for those "
            "that E57 and PTX files hold.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    pose_sigma: Annotated[
        float,
        typer.Option(
            "--pose-sigma",
            metavar="METERS",
            help="Standard deviation of the poses of --poses, in meters along each axis.",
            rich_help_panel=_PANEL,
        ),
    ] = 0.05
    pose_degrees: Annotated[
        float,
        typer.Option(
            "--pose-degrees",
            metavar="DEGREES",
            help="Standard deviation of the poses of --poses, in degrees about each axis.",
            rich_help_panel=_PANEL,
        ),
    ] = 0.5
    control: Annotated[
        Path | None,
        typer.Option(
            "--control",
            metavar="FILE.csv",
            help="Control points: a table with the header name, scan, x, y, z, X, Y, Z; x y z in the frame of the "
            "scan's file, its pose applied, X Y Z in the world, in meters. Residuals go to control.csv.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    level: Annotated[
        bool,
        typer.Option(
            "--level/--no-level",
            help="Turn frames that nothing else fixes so that z points up, where half of the scans agree about it.",
            rich_help_panel=_PANEL,
        ),
    ] = True

    def check(self) -> None:
        """Check what can be checked before scans are read.

        Raises:
            ValueError: options that do not fit together, or a deviation that is not above 0.
        """
        positive(self.pose_sigma, "--pose-sigma")
        positive(self.pose_degrees, "--pose-degrees")
        other = "--fix" if self.fix is not None else "--poses" if self.poses is not None else ""
        expect(self.control is None or not other, "--control", "neither --fix nor --poses beside it", other)

    @property
    def files(self) -> list[Path]:
        """The tables that are read."""
        poses = [] if self.poses in (None, OF_FILES) else [Path(str(self.poses))]
        return [*poses, *([] if self.control is None else [self.control])]

    def check_tables(self) -> None:
        """Check the tables as far as that is possible before scans are read, which takes long.

        Raises:
            CloudFileError: a table that cannot be read, lacks a column or has a cell that is no number.
        """
        if self.poses is not None and self.poses != OF_FILES:
            check_poses_csv(self.poses)
        if self.control is not None:
            check_control_points(self.control)

    def frame(self, names: Sequence[str], posed: Sequence[bool]) -> SiteFrame:
        """What is known of the frame of scans of these names; ``posed``: whether their files have poses for them.

        Raises:
            CloudFileError: a table that cannot be read, or a scan that is not among these.
            ValueError: the poses of files are asked for and there are none.
        """
        poses: tuple[tuple[int, torch.Tensor], ...] = ()
        if self.poses == OF_FILES:
            expect_in_words(any(posed), "--poses", "files with poses, such as E57 and PTX have", "files without poses")
            eye = torch.eye(4, dtype=torch.float64)
            poses = tuple((scan, eye) for scan, there in enumerate(posed) if there)
        elif self.poses is not None:
            poses = tuple((each.scan, each.T_world_scan) for each in read_poses_csv(self.poses, names))
        return SiteFrame(
            fix=None if self.fix is None else scan_number(self.fix, names, "--fix"),
            poses=poses,
            pose_meters=self.pose_sigma,
            pose_degrees=self.pose_degrees,
            control=() if self.control is None else tuple(read_control_points(self.control, names)),
            level=self.level,
        )


def write_control_csv(path: Path, points: Sequence[JudgedPoint], names: Sequence[str]) -> None:
    """Write control points with their residuals in meters, empty where there is none, in full or not at all."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_RESIDUALS)
    for point, meters, suspicious in points:
        residual = "" if math.isnan(meters) else repr(meters)
        where = map(repr, point.world)
        writer.writerow([cell_of_text(point.name), cell_of_text(names[point.scan]), *where, residual, int(suspicious)])
    write_text(path, text.getvalue(), through_link=False)


def remove_control_csv(path: Path) -> None:
    """Remove the residuals of an earlier run, which say nothing of this one; another file of this name stays."""
    if path.is_file() and not path.is_symlink():
        with path.open("rb") as file:
            ours = file.readline(1000).rstrip() == ",".join(_RESIDUALS).encode()
        if ours:
            path.unlink()


def points_in_words(points: Sequence[JudgedPoint], names: Sequence[str]) -> list[str]:
    """What is to be said of control points, the worst ones first."""
    there = [each for each in points if not math.isnan(each.meters)]
    if not there:
        return []
    good = [each.meters for each in there if not each.suspicious]
    lines = [f"control points: {len(good)} of {len(points)} agree, residuals up to {1000 * max(good):.1f} mm"]
    for point, meters, suspicious in sorted(there, key=lambda each: -each.meters):
        if suspicious:
            lines.append(f"control point {point.name} in {names[point.scan]} is suspicious: {meters:.3f} m off")
    return lines
