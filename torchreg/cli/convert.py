"""``torchreg convert``: a cloud in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer

from torchreg.cli import options as opt
from torchreg.cli.expand import option_of
from torchreg.cli.output import Output, check_outputs, standard_output
from torchreg.cli.progress import reading_bar, step
from torchreg.cli.wording import by_options
from torchreg.io import CloudFile, Reading, read_cloud_report, write_cloud
from torchreg.io.formats import CAPACITIES, WRITERS, alternatives, formats_in_words
from torchreg.io.placement import viewpoint_of_text
from torchreg.io.written import narrowest
from torchreg.settings import Settings

SourcePath = Annotated[Path, typer.Argument(metavar="FROM", help=f"The cloud to read: {formats_in_words()}.")]
TargetPath = Annotated[
    Path, typer.Argument(metavar="TO", help=f"The {alternatives(WRITERS)} file to write, coordinates in meters.")
]
Voxel = Annotated[
    float | None,
    typer.Option(
        "--voxel",
        metavar="METERS",
        help="Edge in meters of the cubes in which points are averaged while they are read; by default all are kept.",
        rich_help_panel=opt.INPUT,
    ),
]


def convert(
    source: SourcePath,
    target: TargetPath,
    scan: opt.ScanText = None,
    columns: opt.ColumnsText = None,
    units: opt.UnitsText = None,
    voxel: Voxel = None,
    intensity: Annotated[bool, option_of(Settings, "intensity")] = False,
    viewpoint: opt.ViewpointText = "auto",
) -> None:
    """Write the cloud of one file in another format: coordinates, colors, normals and the scanner's position.

    What the new format cannot hold is said. Exit code 0: written. 2: bad usage or an unreadable file.
    """
    check_outputs([Output("TO", target, tuple(WRITERS))], [source])
    reading = Reading(
        viewpoint=viewpoint_of_text(viewpoint, "--viewpoint"),
        dtype=torch.float64,
        columns=columns,
        units=units,
        voxel=voxel,
        intensity=intensity,
    )
    with reading_bar(source.name) as progress:
        report = read_cloud_report(source, scan=scan, reading=reading, progress=progress)
    cloud = narrowest(report.cloud)
    with step(f"writing {target.name}"):
        write_cloud(target, cloud)
    lines = [f"{target}: {_contents(report)}", *(f"note: {by_options(note)}" for note in report.notes)]
    lines += [f"not kept: {loss}" for loss in (*CAPACITIES[target.suffix.lower()].losses(cloud), *_left(report))]
    standard_output().print("\n".join(lines), soft_wrap=True)


def _contents(report: CloudFile) -> str:
    cloud = report.cloud
    known, assumed = bool(cloud.viewpoint_known[0]), bool(cloud.viewpoint_assumed[0])
    parts = [f"{len(cloud.points):,} of {report.points_in_file:,} points"]
    parts += ["colors"] * report.has_colors + ["normals"] * report.has_normals
    parts += [f"scanner {'known' if known else 'assumed'}"] * (known or assumed)
    return f"{', '.join(parts)}; read as {report.format}"


def _left(report: CloudFile) -> tuple[str, ...]:
    """What no writer here keeps."""
    if report.intensity is None or report.color_depth == "intensity":
        return ()
    return ("the intensity is left out",)
