"""``torchreg info``: what a file holds."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.output import STANDARD_OUTPUT, standard_output, write_json
from torchreg.cli.progress import step
from torchreg.io import CloudFile, read_cloud_report
from torchreg.io.placement import viewpoint_of_text
from torchreg.registration import derive_options, spacing
from torchreg.registration.inspect import refuse
from torchreg.types import RegistrationOptions

CloudPath = Annotated[Path, typer.Argument(metavar="FILE", help="A .ply, .pcd or .npz file, coordinates in meters.")]


def info(file: CloudPath, json: opt.JsonSwitch = False, viewpoint: opt.ViewpointText = "auto") -> None:
    """Say what a cloud's FILE holds: points, colors, extent and spacing in meters, and the options that follow.

    Exit code 0: the file can be read. 2: it cannot.
    """
    from torchreg.report import cloud_table

    with step(f"reading {file.name}"):
        found = read_cloud_report(file, viewpoint=viewpoint_of_text(viewpoint, "--viewpoint"))
    failure = refuse(found.cloud, found.cloud)[0]
    defect = "" if failure is None else failure.text.replace("the source", "it")
    options, apart = None, 0.0
    if not defect:
        with step("measuring the spacing of the points"):
            apart = float(spacing(found.cloud))
            options = derive_options(found.cloud, found.cloud)[0]
    if json:
        write_json(STANDARD_OUTPUT, _content(found, apart, options, defect))
    else:
        standard_output().print(cloud_table(found, apart, options, defect))


def _content(file: CloudFile, apart: float, options: RegistrationOptions | None, defect: str) -> dict[str, object]:
    viewpoint = file.cloud.viewpoint
    known = viewpoint is not None and not bool(viewpoint.isnan().any())
    position = (viewpoint[0].double() + file.cloud.origin[0]).tolist() if viewpoint is not None and known else None
    return {
        "file": file.path,
        "format": file.format,
        "points_in_file": file.points_in_file,
        "dropped_non_finite": file.dropped_non_finite,
        "has_colors": file.has_colors,
        "color_depth": file.color_depth,
        "has_normals": file.has_normals,
        "viewpoint": position,
        "viewpoint_source": file.viewpoint_source,
        "origin": file.cloud.origin[0].tolist(),
        "extent": list(file.extent),
        "spacing": apart,
        "options": None if options is None else asdict(options),
        "cannot_be_registered": defect or None,
        "notes": list(file.notes),
    }
