"""``torchreg site``: many scans into one frame."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple

import torch
import typer

from torchreg.cli import options as opt
from torchreg.cli.expand import expanded, option_of
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import Output, check_outputs, standard_output, write_json
from torchreg.cli.progress import batch_progress, reading_bar, step
from torchreg.cli.site_frame import HowToFrame, framed, points_in_words, write_control_csv
from torchreg.cli.wording import by_options
from torchreg.errors import CloudFileError, expect, one_of, positive
from torchreg.io import Reading, read_scans, write_cloud
from torchreg.io.formats import WRITERS, alternatives, formats_in_words
from torchreg.io.placement import viewpoint_of_text
from torchreg.io.poses_csv import write_poses_csv
from torchreg.report import REPORT_SUFFIXES
from torchreg.report.text import legible, plain
from torchreg.settings import LARGEST_READ, Settings
from torchreg.site.merged import merged_cloud
from torchreg.site.register_site import register_site
from torchreg.site.result import SiteResult
from torchreg.site.site_json import site_to_dict
from torchreg.types import Clouds
from torchreg.verification import WORK

ScanPaths = Annotated[
    list[Path],
    typer.Argument(
        metavar="SCANS...",
        help=f"The files of the scans, coordinates in meters: {formats_in_words()}. A file with several scans gives "
        "all of them.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class HowToRead:
    """How scans are read."""

    voxel: Annotated[
        float | None,
        typer.Option(
            "--voxel",
            metavar="METERS",
            help="Edge in meters of the cubes in which points are averaged while they are read; by default only scans "
            f"of more than {LARGEST_READ:,} points are.",
            rich_help_panel=opt.INPUT,
        ),
    ] = None
    viewpoint: opt.ViewpointText = "auto"
    columns: opt.ColumnsText = None
    units: opt.UnitsText = None
    intensity: Annotated[bool, option_of(Settings, "intensity")] = False

    def reading(self) -> Reading:
        """The same for all files."""
        return Reading(
            viewpoint=viewpoint_of_text(self.viewpoint, "--viewpoint"),
            columns=self.columns,
            units=self.units,
            voxel=self.voxel,
            at_most=None if self.voxel is not None else LARGEST_READ,
            intensity=self.intensity,
        )


@dataclass(frozen=True, kw_only=True)
class SiteOutputs:
    """What is written beside poses.csv and site.json."""

    merged: Annotated[
        Path | None,
        typer.Option(
            "--merged",
            metavar="FILE.ply",
            help="Write the scans of the largest group as one cloud, thinned, coordinates in meters, as a "
            f"{alternatives(WRITERS)} file.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
    spacing: Annotated[
        float,
        typer.Option(
            "--spacing",
            metavar="METERS",
            help="Edge in meters of the cubes over which the points of --merged are averaged.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = 0.02
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE.html",
            help="Write one page with verdict, tables of scans and links, and all scans in 3D, lengths in meters, as a "
            f"{alternatives(REPORT_SUFFIXES)} file that opens without a network.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None


class _Scan(NamedTuple):
    name: str
    cloud: Clouds
    trouble: str = ""  # why it could not be read
    notes: tuple[str, ...] = ()
    posed: bool = False  # whether its file has a pose for it, which its points have applied


@expanded
def site(
    scans: ScanPaths,
    reading: HowToRead,
    outputs: SiteOutputs,
    wanted: HowToFrame,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Folder of the results, made if need be.",
            rich_help_panel=opt.OUTPUT,
        ),
    ],
    effort: Annotated[
        str,
        typer.Option(
            "--effort",
            metavar="|".join(WORK),
            help="Work spent per pair, as for torchreg register.",
            rich_help_panel="Search",
        ),
    ] = "balanced",
    seed: opt.Seed = 0,
    max_bytes: Annotated[
        int | None,
        typer.Option(
            "--max-bytes",
            metavar="BYTES",
            min=1,
            help="Memory in bytes for the pairs that are registered together; by default a quarter of what is free.",
            rich_help_panel=opt.RUN,
        ),
    ] = None,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
) -> None:
    """Put many SCANS into one frame, in any order and without a first guess; all lengths are in meters.

    DIR gets poses.csv (scan, group, m00 to m33: x_world = R x_scan + t, row by row, in the frame of each scan's file;
    empty where a scan is not placed) and site.json (poses with their covariances, every candidate of every pair with
    its verdict). Group 0 is the largest; groups that do not connect have frames of their own, level where half of the
    scans agree about up. Known poses and control points (control.csv: their residuals) fix the frame instead.

    Exit code 0: all scans are placed in one frame. 2: bad usage, or no scan can be read. 3: some scans are not placed
    or not in one frame; the results say which and why.
    """
    where = opt.use(device, threads)
    one_of(effort, "--effort", tuple(WORK))
    wanted.check()
    _check([*scans, *wanted.files], outputs, out)
    read = _read(scans, reading.reading())
    names = [scan.name for scan in read]
    frame = wanted.frame(names, [scan.posed for scan in read])
    with batch_progress() as report:
        result = register_site(
            [scan.cloud.to(where) for scan in read], effort=effort, seed=seed, max_bytes=max_bytes, report=report
        )
    result, points, remarks = framed(_with_notes(result, read), frame, [scan.cloud for scan in read])
    out.mkdir(exist_ok=True)
    write_poses_csv(out / "poses.csv", names, result.group, result.T_world_scan)
    write_json(out / "site.json", site_to_dict(result, names, seed=seed))
    written = [out / "poses.csv", out / "site.json", *_write(outputs, result, read)]
    if points:
        write_control_csv(out / "control.csv", points, names)
        written.append(out / "control.csv")
    _show(result, names)
    for line in (*points_in_words(points, names), *remarks):
        complain(legible(line))
    complain(f"wrote {', '.join(map(str, written))}")
    if not bool(result.placed.all()) or int(result.group.max()) > 0:
        raise typer.Exit(NOT_REGISTERED)


def _check(inputs: Sequence[Path], outputs: SiteOutputs, out: Path) -> None:
    """Check before the work begins that everything can be written."""
    positive(outputs.spacing, "--spacing")
    fits = out.absolute().parent.is_dir() and (not out.exists() or out.is_dir())
    expect(fits, "--out", "a folder, or a name for one in a folder that exists", str(out))
    files = (
        Output("--merged", outputs.merged, tuple(WRITERS)),
        Output("--report", outputs.report, REPORT_SUFFIXES),
        *(Output("--out", out / name) for name in ("poses.csv", "site.json", "control.csv") if out.is_dir()),
    )
    check_outputs(files, inputs)


def _read(paths: Sequence[Path], reading: Reading) -> list[_Scan]:
    """The scans of all files; one that cannot be read stands there without points, so that the others go on.

    Raises:
        CloudFileError: no file can be read.
    """
    scans: list[_Scan] = []
    for path in paths:
        try:
            with reading_bar(path.name) as progress:
                files = read_scans(path, reading=reading, progress=progress)
        except CloudFileError as error:
            complain(str(error))
            scans.append(_Scan(os.fspath(path), Clouds(torch.zeros(0, 3)), by_options(str(error))))
            continue
        for number, file in enumerate(files):
            name = os.fspath(path) if len(files) == 1 else f"{path} [{file.scan or number}]"
            notes = tuple(by_options(note) for note in file.notes)
            scans.append(_Scan(name, file.cloud, notes=notes, posed=file.pose is not None))
    if all(scan.trouble for scan in scans):
        raise CloudFileError(f"SCANS: expected files of scans, got none that can be read ({len(scans)} given)")
    return scans


def _with_notes(result: SiteResult, scans: Sequence[_Scan]) -> SiteResult:
    """The result with what reading the files showed."""
    reasons = tuple(scan.trouble or reason for scan, reason in zip(scans, result.reason, strict=True))
    notes = tuple((*scan.notes, *notes) for scan, notes in zip(scans, result.notes, strict=True))
    return replace(result, reason=reasons, notes=notes)


def _write(outputs: SiteOutputs, result: SiteResult, scans: Sequence[_Scan]) -> list[Path]:
    """Write what is asked for beside the poses; returns the files."""
    from torchreg.report.page.site_report import write_site_report

    clouds, names = [scan.cloud for scan in scans], [scan.name for scan in scans]
    written = []
    if outputs.merged is not None and not bool(result.placed.any()):
        complain(f"{outputs.merged} not written: no scan is placed")
    elif outputs.merged is not None:
        with step(f"writing {outputs.merged.name}"):
            write_cloud(outputs.merged, merged_cloud(clouds, result, spacing=outputs.spacing))
        written.append(outputs.merged)
    if outputs.report is not None:
        with step(f"writing {outputs.report.name}"):
            write_site_report(outputs.report, result, clouds, names=_short(names))
        written.append(outputs.report)
    return written


def _short(names: Sequence[str]) -> list[str]:
    """The names without the folder that all share."""
    folder = os.path.commonpath([os.path.dirname(os.path.abspath(name)) for name in names])
    return [os.path.relpath(name, folder) for name in names]


def _show(result: SiteResult, names: Sequence[str]) -> None:
    from torchreg.report.site_text import summary_of

    standard_output().print(plain(summary_of(result, names)), soft_wrap=True)
