"""What ``torchreg site`` writes beside poses.csv and site.json, and the options that ask for it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from torchreg.cli import options as opt
from torchreg.cli.guard import complain
from torchreg.cli.output import Output, check_outputs
from torchreg.cli.placed_scans import PLACED_SUFFIXES, InputScan, check_placed, write_placed
from torchreg.cli.progress import step
from torchreg.errors import expect, positive
from torchreg.io import PointFields, Reading, write_cloud
from torchreg.io.formats import CAPACITIES, SCANS_WRITERS, WRITERS, alternatives
from torchreg.io.redwood_log import write_redwood_trajectory
from torchreg.report import REPORT_SUFFIXES
from torchreg.site.files import FileScans
from torchreg.site.merged import merged_cloud
from torchreg.site.result import SiteResult
from torchreg.site.stored import FoundScans

_TRAJECTORY_SUFFIXES = (".log",)


@dataclass(frozen=True, kw_only=True)
class SiteOutputs:
    """What is written beside poses.csv and site.json."""

    merged: Annotated[
        Path | None,
        typer.Option(
            "--merged",
            metavar="FILE.ply",
            help="Write the scans of the largest group as one cloud, thinned, coordinates in meters, as a "
            f"{alternatives(WRITERS)} file; LAS, LAZ and PLY say which scan each point comes from.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
    spacing: Annotated[
        float,
        typer.Option(
            "--spacing",
            metavar="METERS",
            help="Edge in meters of the cubes in which the points of --merged are averaged.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = 0.02
    placed: Annotated[
        Path | None,
        typer.Option(
            "--placed",
            metavar="FOLDER|FILE.e57",
            help="Write every placed scan with its new pose, at full resolution: into a folder, each in the "
            "format it came in (E57 and PTX with the pose in the header, others with their points moved), or those of "
            f"the largest group into one {alternatives(SCANS_WRITERS)} file.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
    placed_format: Annotated[
        str | None,
        typer.Option(
            "--placed-format",
            metavar="SUFFIX",
            help=f"Write the scans of --placed as {alternatives(PLACED_SUFFIXES)} files, whatever format they came in.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
    redwood: Annotated[
        Path | None,
        typer.Option(
            "--redwood",
            metavar="FILE.log",
            help="Write the poses of the largest group as a Redwood trajectory, which Open3D reads.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
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


def check_site_outputs(outputs: SiteOutputs, scans: Sequence[Path], out: Path) -> None:
    """Check before the work begins that everything can be written."""
    positive(outputs.spacing, "--spacing")
    fits = out.absolute().parent.is_dir() and (not out.exists() or out.is_dir())
    expect(fits, "--out", "a folder, or a name for one in a folder that exists", str(out))
    files = (
        Output("--merged", outputs.merged, tuple(WRITERS)),
        Output("--redwood", outputs.redwood, _TRAJECTORY_SUFFIXES),
        Output("--report", outputs.report, REPORT_SUFFIXES),
        *(Output("--out", out / name) for name in ("poses.csv", "site.json", "control.csv") if out.is_dir()),
        *check_placed(outputs.placed, _suffix(outputs), scans),
    )
    check_outputs(files, scans)


class _Written(NamedTuple):
    outputs: SiteOutputs
    result: SiteResult
    found: FoundScans
    reading: Reading
    before: Sequence[Path]


def write_site_outputs(
    outputs: SiteOutputs, result: SiteResult, found: FoundScans, reading: Reading, before: Sequence[Path]
) -> list[Path]:
    """Write what is asked for beside the files that were written ``before``; returns files and folders."""
    work = _Written(outputs, result, found, reading, before)
    written = []
    for path, write in (
        (outputs.merged, _write_merged),
        (outputs.redwood, _write_redwood),
        (outputs.report, _write_report),
        (outputs.placed, _write_placed),
    ):
        if path is None:
            continue
        if not bool(result.placed.any()) and write is not _write_report:
            complain(f"{path} not written: no scan is placed")
            continue
        write(path, work)
        written.append(path)
    return written


def _write_merged(path: Path, work: _Written) -> None:
    with step(f"writing {path.name}"):
        merged = merged_cloud(FileScans(work.found.sources), work.result, spacing=work.outputs.spacing)
        fields = PointFields(scan=merged.scan)
        write_cloud(path, merged.cloud, fields=fields)
    for loss in CAPACITIES[path.suffix.lower()].losses(merged.cloud, fields):
        complain(f"{path}: {loss}")


def _write_redwood(path: Path, work: _Written) -> None:
    first = (work.result.group == 0).nonzero()[:, 0]
    write_redwood_trajectory(path, first.tolist(), work.result.T_world_scan[first])


def _write_placed(path: Path, work: _Written) -> None:
    outputs = work.outputs
    inputs = [InputScan(Path(path), argument) for path, argument in work.found.files]
    others = [one for one in (outputs.merged, outputs.redwood, outputs.report) if one is not None]
    write_placed(path, _suffix(outputs), inputs, work.result, work.reading, [*others, *work.before])


def _write_report(path: Path, work: _Written) -> None:
    from torchreg.report.page.site_report import write_site_report

    with step(f"writing {path.name}"):
        names = _short(work.found.names)
        write_site_report(path, work.result, FileScans(work.found.sources), names=names)


def _suffix(outputs: SiteOutputs) -> str | None:
    """The format of placed scans, with its dot."""
    return None if outputs.placed_format is None else f".{outputs.placed_format.lower().removeprefix('.')}"


def _short(names: Sequence[str]) -> list[str]:
    """The names without the folder that all share."""
    folder = os.path.commonpath([os.path.dirname(os.path.abspath(name)) for name in names])
    return [os.path.relpath(name, folder) for name in names]
