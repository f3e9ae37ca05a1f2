"""``torchreg bench paper``: the paper's experiments."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.bench.shared import Out, Quick, expect_folder, run_and_show

Experiments = Annotated[
    list[int] | None,
    typer.Option(
        "--experiment",
        metavar="1..5",
        min=1,
        max=5,
        help="Only this experiment, from 1 to 5; may be given several times.",
    ),
]
Seeds = Annotated[
    int | None,
    typer.Option(
        "--seeds",
        metavar="COUNT",
        min=1,
        help="Number of simulated malls and of roads: 60, or 1 with --quick, by default. More continue a run of fewer.",
    ),
]
Real = Annotated[
    Path | None,
    typer.Option(
        "--real",
        metavar="PATH",
        help="Also on the real pairs of this list, or of the folder's pairs.json: those with colors and much overlap.",
    ),
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
    equalization, on simulated scans and, with --real, on real ones; all lengths in meters. RANSAC runs three times on
    every place, with normals turned to the scanner and with signs left as they come, as the paper most likely had them.
    Shares found, median RMSE and what color changes at the same places, with 95 % intervals over the places.

    A run of 60 malls and 60 roads takes about an hour of one core; stopped, it goes on where it was, places in turn.
    Experiment 4 measures times: run it alone on a quiet machine. --quick takes a quarter of the points and coarse
    scans.

    Exit code 0: all was measured. 2: bad usage, or a file that cannot be read.
    """
    from torchreg.benchmark.paper.settings import EXPERIMENTS
    from torchreg.benchmark.paper.study import paper_study

    expect_folder(out)
    study = paper_study(
        tuple(sorted(set(experiment))) if experiment else EXPERIMENTS,
        seeds=seeds or (1 if quick else 60),
        seed=seed,
        real=real,
        quick=quick,
        device=opt.use(device, threads).type,
    )
    run_and_show(study, out)
