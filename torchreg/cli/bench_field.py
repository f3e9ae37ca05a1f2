"""``torchreg bench field``: methods of the field on real pairs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.bench_options import Methods, Out, Scenes, expect_folder, names_of
from torchreg.cli.guard import complain
from torchreg.cli.output import standard_output
from torchreg.report.text import legible

if TYPE_CHECKING:
    from torchreg.benchmark.field.document import Findings

Data = Annotated[
    Path,
    typer.Option("--data", metavar="PATH", help="List of the pairs, or the folder whose pairs.json it is."),
]
Quick = Annotated[
    bool,
    typer.Option("--quick", help="Take of every scene only the pair that overlaps most, as a trial."),
]


def field(
    data: Data,
    out: Out = Path("torchreg_field"),
    methods: Methods = None,
    scenes: Scenes = None,
    quick: Quick = False,
    seed: opt.Seed = 0,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
) -> None:
    """Set this library beside Open3D, KISS-Matcher and others on real pairs of known truth.

    Registration recall by errors and by RMSE, feature-match recall, inlier ratio, RRE in degrees, RTE in meters and
    seconds, by scene and by overlap, with 95 % intervals over the pairs. All get the same clouds and lengths. A method
    whose package is not installed stands in the tables as such.

    FOLDER holds field.md with all tables, field.csv and field.json. A run that was cut off is resumed.

    Exit code 0: everything is there but for what is not installed. 2: bad usage, or a file that cannot be read.
    """
    from torchreg.benchmark.field.session import Session

    expect_folder(out)
    session = Session(
        data=data,
        out=out,
        methods=names_of(methods),
        scenes=names_of(scenes),
        quick=quick,
        device=str(opt.use(device, threads)),
        seed=seed,
    )
    _show(session.run(report=complain), out)


def _show(findings: Findings, out: Path) -> None:
    from rich.table import Table

    from torchreg.benchmark.field.document import tables

    console = standard_output()
    for one in tables(findings)[:2]:
        table = Table(*one.head, title=one.heading, title_justify="left")
        for row in one.rows:
            table.add_row(*row)
        console.print(table)
    console.print(f"All tables: {legible(str(out / 'field.md'))}", soft_wrap=True)
