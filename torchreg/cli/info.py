"""``torchreg info``: what a file holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.guard import complain
from torchreg.cli.output import STANDARD_OUTPUT, Output, check_outputs, standard_output, write_json
from torchreg.cli.progress import reading_bar, step
from torchreg.cli.wording import by_options
from torchreg.io import CloudFile, Reading
from torchreg.io.formats import formats_in_words
from torchreg.io.placement import viewpoint_of_text
from torchreg.io.reading import chosen_scan, finished, scans_of
from torchreg.io.result_json import plain_data
from torchreg.io.scan_heads import ScanHead, plain_heads, scan_heads
from torchreg.registration import derive_options
from torchreg.registration.inspect import refuse
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.spacing import spacing
from torchreg.settings import LARGEST_READ

CloudPath = Annotated[
    Path, typer.Argument(metavar="FILE", help=f"A cloud, coordinates in meters: {formats_in_words()}.")
]


def info(
    file: CloudPath,
    json: opt.JsonFile = None,
    viewpoint: opt.ViewpointText = "auto",
    scan: opt.ScanText = None,
    columns: opt.ColumnsText = None,
    units: opt.UnitsText = None,
) -> None:
    """Show what a cloud's FILE holds: points, colors, extent and spacing in meters, and the options that follow.

    Of a file of several scans it shows a table of them, and what one of them holds with --scan.

    Exit code 0: the file can be read. 2: it cannot.
    """
    from torchreg.report import cloud_table

    check_outputs([Output("--json", json)], [file])
    place = viewpoint_of_text(viewpoint, "--viewpoint")
    reading = Reading(viewpoint=place, columns=columns, units=units, at_most=LARGEST_READ)
    with reading_bar(file.name) as progress:
        scans = scans_of(file, columns)
        heads = scan_heads(scans) if scan is None and len(scans) > 1 else []
        report = None if heads else finished(file, chosen_scan(file, scans, scan), reading, progress)
    if report is None:
        _show_scans(file, heads, json)
        return
    report = replace(report, notes=tuple(by_options(note) for note in report.notes))
    cloud = report.cloud
    failure = refuse(cloud, cloud)[0]
    defect = "" if failure is None else failure.text.replace("the source", "it")
    options, apart = None, 0.0
    if not defect:
        with step("measuring the spacing of the points"):
            apart = float(spacing(cloud))
            options = derive_options(cloud, cloud)[0]
    if json is not None:
        write_json(json, _content(report, apart, options, defect))
    if json == STANDARD_OUTPUT:
        return
    standard_output().print(cloud_table(report, apart, options, defect))
    if json is not None:
        complain(f"wrote {json}")


def _show_scans(file: Path, heads: Sequence[ScanHead], json: Path | None) -> None:
    """Show the scans of a file of several."""
    from torchreg.report.scans_table import scans_table

    if json is not None:
        write_json(json, plain_heads(file, heads))
    if json == STANDARD_OUTPUT:
        return
    standard_output().print(scans_table(str(file), heads))
    complain("--scan NUMBER shows more of one scan" + ("" if json is None else f"; wrote {json}"))


def _content(file: CloudFile, apart: float, options: RegistrationOptions | None, defect: str) -> dict[str, object]:
    viewpoint = file.cloud.viewpoint
    position = None if viewpoint is None else (viewpoint[0].double() + file.cloud.origin[0]).tolist()
    return {
        "file": file.path,
        "format": file.format,
        "points_in_file": file.points_in_file,
        "dropped_non_finite": file.dropped_non_finite,
        "has_colors": file.has_colors,
        "color_depth": file.color_depth,
        "has_normals": file.has_normals,
        "viewpoint": position,
        "viewpoint_known": bool(file.cloud.viewpoint_known[0]),
        "viewpoint_source": file.viewpoint_source,
        "scan": file.scan,
        "pose": None if file.pose is None else file.pose.tolist(),
        "has_intensity": file.intensity is not None,
        "unit": file.unit,
        "voxel": file.voxel,
        "origin": file.cloud.origin[0].tolist(),
        "extent": list(file.extent),
        "spacing": apart,
        "options": plain_data(options),
        "cannot_be_registered": defect or None,
        "notes": list(file.notes),
    }
