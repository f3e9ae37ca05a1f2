"""``torchreg bench paper``: the paper's five experiments."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.bench_options import Out, expect_folder
from torchreg.cli.guard import complain
from torchreg.cli.output import standard_output
from torchreg.report.text import legible

if TYPE_CHECKING:
    from torchreg.benchmark.paper.document import Findings

Experiments = Annotated[
    list[int] | None,
    typer.Option(
        "--experiment",
        metavar="1..5",
        min=1,
        max=5,
        help="Run only this experiment, from 1 to 5; may be given several times; by default all.",
    ),
]
Seeds = Annotated[
    int | None,
    typer.Option(
        "--seeds",
        metavar="COUNT",
        min=1,
        help="Number of simulated malls and roads; by default 10, and 1 with --quick.",
    ),
]
Real = Annotated[
    Path | None,
    typer.Option(
        "--real",
        metavar="PATH",
        help="Run also on the real pairs of this list, or of the pairs.json of this folder, that have colors and much "
        "overlap.",
    ),
]
Quick = Annotated[
    bool,
    typer.Option("--quick", help="Take a quarter of the points and coarse scans, as a trial of some seconds."),
]


def paper(
    out: Out = Path("torchreg_paper"),
    experiment: Experiments = None,
    seeds: Seeds = None,
    real: Real = None,
    quick: Quick = False,
    seed: opt.Seed = 0,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
) -> None:
    """Run the paper's five experiments, and write its Tables 5 to 9 with our numbers beside its own.

    Experiments: 1 three initial poses at 10,000 points, 2 12,000 points against 4,000, 3 4,000 down to 500 points, 4
    times with and without color, 5 an outdoor road. FPFH alone, FPFH + PCFH, and the same without histogram
    equalization, on simulated scans and, with --real, on real ones; all lengths in meters.

    FOLDER holds paper.md with all tables and pictures, the tables as CSV, and paper.json. A run that was cut off is
    resumed.

    Exit code 0: everything is there. 2: bad usage, or a file that cannot be read.
    """
    from torchreg.benchmark.paper.session import Session
    from torchreg.benchmark.paper.settings import EXPERIMENTS

    expect_folder(out)
    chosen = tuple(sorted(set(experiment))) if experiment else EXPERIMENTS

    session = Session(
        out=out,
        experiments=chosen,
        seeds=seeds or (1 if quick else 10),
        seed=seed,
        real=real,
        quick=quick,
        device=opt.use(device, threads).type,
    )
    _show(session.run(report=complain), out)


def _show(findings: Findings, out: Path) -> None:
    """The overview, what PCFH adds to the times, and where the rest lies."""
    from rich.table import Table

    from torchreg.benchmark.paper.document import overview
    from torchreg.benchmark.paper.time_table import added_in_words

    console = standard_output()
    if findings.errors:
        shown = overview(findings)
        table = Table(*shown.head, title=shown.heading, title_justify="left")
        for row in shown.rows:
            table.add_row(*row)
        console.print(table)
    if findings.times:
        console.print(added_in_words(findings.times), soft_wrap=True)
    console.print(f"All tables and pictures: {legible(str(out / 'paper.md'))}", soft_wrap=True)
