"""``torchreg demo``: a simulated mall, registered with geometry alone, with color, and by default."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import torch
import typer

from torchreg.cli import options as opt
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import Output, check_outputs, standard_output
from torchreg.cli.progress import step
from torchreg.datasets import ScanPair, mall
from torchreg.io import write_cloud, write_result_json, write_transform_text
from torchreg.metrics import inlier_ratio, pose_errors, recalled_by_rmse
from torchreg.registration import PAPER, derive_options
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.register import register
from torchreg.report import FIGURE_SUFFIXES, DemoRow, demo_figure, demo_sentence, demo_table, save_figure
from torchreg.solvers import RansacOptions
from torchreg.types import RegistrationResult

OutFolder = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="FOLDER",
        help="Write both scans (PLY, in meters), the true transform and the result of the default options there.",
        rich_help_panel="Output",
    ),
]
AngularStep = Annotated[
    float,
    typer.Option(
        "--angular-step", metavar="DEGREES", min=0.05, max=5, help="Angle between neighboring rays, in degrees."
    ),
]
PictureFile = Annotated[
    Path | None,
    typer.Option(
        "--figure",
        metavar="FILE.png",
        help="Draw the clouds before and under the transform of each method, axes in meters (.png, .pdf or .svg); by "
        "default nothing is drawn or written.",
        rich_help_panel="Output",
    ),
]


def demo(
    seed: opt.Seed = 2,
    angular_step: AngularStep = 0.4,
    figure: PictureFile = None,
    out: OutFolder = None,
) -> None:
    """Scan a simulated mall twice, register the scans, and show what color adds to geometry.

    FPFH alone and FPFH with PCFH run with the paper's lengths in meters, on some 10,000 points averaged over voxels;
    then lengths derived from the scans: the plain procedure without color, and the default. A result is
    right where its RMSE under the true motion is below its inlier threshold. Exit code 0: the result of the default
    options is right. 3: it is not.
    """
    check_outputs([Output("--figure", figure, FIGURE_SUFFIXES)], [])
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    with step("scanning a simulated mall from two stations", at_once=True):
        pair = mall(seed, angular_step=angular_step)
    default = derive_options(pair.source, pair.target)[0]
    paper = replace(PAPER, voxel_size=default.voxel_size)
    ransac = RansacOptions(inlier_threshold=default.inlier_threshold)
    plain = replace(default, solver=ransac, effort="plain", refine="none")
    runs: list[tuple[str, RegistrationOptions]] = [
        ("paper: FPFH alone", paper.without_color()),
        ("paper: FPFH + PCFH", paper),
        ("plain, without color", plain.without_color()),
        ("default", default),
    ]
    rows: list[DemoRow] = []
    for method, options in runs:
        with step(f"registering by {method}", at_once=True):
            row, result = _run(pair, method, options, seed)
        rows.append(row)
    written = [] if out is None else _write(out, pair, result, seed)
    if figure is not None:
        with step(f"drawing {figure.name}", at_once=True):
            shown = [(f"{row.method}: {'right' if row.right else 'wrong'}", row.T_target_source) for row in rows[2:]]
            title = f"Two scans of a simulated mall (seed {seed})"
            save_figure(demo_figure(pair.source, pair.target, shown, title=title), figure)
        written.append(figure)
    console = standard_output()
    console.print(demo_table(rows))
    console.print(f"\n{demo_sentence(rows[2], rows[3])}", soft_wrap=True)
    if figure is None:
        console.print("To see it: torchreg demo --figure torchreg_demo.png", soft_wrap=True)
    if written:
        complain(f"wrote {', '.join(map(str, written))}")
    if not rows[-1].right:
        raise typer.Exit(NOT_REGISTERED)


def _run(pair: ScanPair, method: str, options: RegistrationOptions, seed: int) -> tuple[DemoRow, RegistrationResult]:
    begin = time.perf_counter()
    result = register(pair.source, pair.target, options, seed=seed)
    seconds = time.perf_counter() - begin
    threshold, T_true = options.inlier_threshold, pair.T_target_source
    T, success = result.T_target_source[0], bool(result.success[0])
    errors = pose_errors(pair.source, T_true, T)
    row = DemoRow(
        method=method,
        points=(len(result.source.points), len(result.target.points)),
        inlier_ratio=float(inlier_ratio(result.source, result.target, result.correspondences, T_true[None], threshold)),
        errors=errors,
        seconds=seconds,
        success=success,
        right=success and bool(recalled_by_rmse(torch.tensor(errors.rmse_meters), bound=threshold)),
        T_target_source=T,
    )
    return row, result


def _write(folder: Path, pair: ScanPair, result: RegistrationResult, seed: int) -> list[Path]:
    """Write both scans, the truth and the result; returns the files."""
    source, target, truth, record = (folder / name for name in ("source.ply", "target.ply", "truth.txt", "result.json"))
    write_cloud(source, pair.source)
    write_cloud(target, pair.target)
    write_transform_text(truth, pair.T_target_source)
    write_result_json(record, result, seed=seed, source=source.name, target=target.name)
    return [source, target, truth, record]
