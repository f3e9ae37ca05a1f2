"""``torchreg bench 3dmatch``: the protocol of 3DMatch on a folder of fragments."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.bench_options import Methods, Out, Scenes, expect_folder, names_of
from torchreg.cli.guard import complain
from torchreg.cli.output import standard_output
from torchreg.errors import positive
from torchreg.report.text import legible

if TYPE_CHECKING:
    from torchreg.benchmark.threedmatch.document import Findings

Folder = Annotated[
    Path,
    typer.Argument(metavar="PATH", help="Folder of the fragments of a scene, or of several such scenes."),
]
Log = Annotated[
    Path | None,
    typer.Option(
        "--log",
        metavar="NAME|FOLDER",
        help="Log that lists the pairs: the name of a file in each scene or beside it, or a folder that holds "
        "SCENE/gt.log for each, as in 3DLoMatch; by default gt.log.",
    ),
]
Voxel = Annotated[
    float,
    typer.Option("--voxel", metavar="METERS", help="Edge in meters of the voxels that points are averaged over."),
]
Quick = Annotated[
    bool,
    typer.Option("--quick", help="Take of every scene only the first pair that counts, as a trial."),
]


def threedmatch(
    folder: Folder,
    out: Out = Path("torchreg_3dmatch"),
    log: Log = None,
    methods: Methods = None,
    scenes: Scenes = None,
    voxel: Voxel = 0.05,
    quick: Quick = False,
    seed: opt.Seed = 0,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
) -> None:
    """Register the pairs of 3DMatch, 3DLoMatch, Color3DMatch or ETH scenes, and print the tables that papers print.

    Fragments are cloud_bin_0.ply, ... (in ETH scenes Hokuyo_0.ply, ...) in a folder a scene, gt.log and gt.info in it
    or in SCENE-evaluation beside it. Registration recall at 0.2 meters by the information matrix over pairs that do not
    follow one another, feature-match recall at 0.1 meters and 5 %, inlier ratio, scene by scene and their mean.

    FOLDER holds 3dmatch.md with all tables, 3dmatch.csv and 3dmatch.json. A run that was cut off is resumed.

    Exit code 0: everything is there but for what is not installed. 2: bad usage, or a file that cannot be read.
    """
    from torchreg.benchmark.threedmatch.session import Session

    expect_folder(out)
    session = Session(
        folder=folder,
        out=out,
        log=log,
        methods=names_of(methods),
        scenes=names_of(scenes),
        voxel=positive(voxel, "--voxel"),
        quick=quick,
        device=str(opt.use(device, threads)),
        seed=seed,
    )
    _show(session.run(report=complain), out)


def _show(findings: Findings, out: Path) -> None:
    from rich.table import Table

    from torchreg.benchmark.threedmatch.document import tables

    console = standard_output()
    for one in tables(findings)[:3]:
        table = Table(*one.head, title=one.heading, title_justify="left")
        for row in one.rows:
            table.add_row(*row)
        console.print(table)
    console.print(f"All tables: {legible(str(out / '3dmatch.md'))}", soft_wrap=True)
