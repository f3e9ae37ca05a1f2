"""``torchreg bench speed``: times of every stage against Open3D."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.bench_options import Out, expect_folder
from torchreg.cli.guard import complain
from torchreg.cli.output import standard_output
from torchreg.errors import at_least, expect
from torchreg.report.text import legible

Points = Annotated[
    str,
    typer.Option("--points", metavar="COUNT,COUNT", help="Numbers of points of each cloud, commas between them."),
]
Repeats = Annotated[
    int, typer.Option("--repeats", metavar="COUNT", min=1, help="Number of runs that count, of everything.")
]
Quick = Annotated[bool, typer.Option("--quick", help="Take few points and two repeats, as a trial of some seconds.")]


def speed(
    out: Out = Path("torchreg_speed"),
    points: Points = "1000,10000,100000,1000000",
    repeats: Repeats = 5,
    quick: Quick = False,
    threads: opt.Threads = None,
) -> None:
    """Time every stage and the whole pair against Open3D's classic and tensor pipelines, in one process.

    Seconds over numbers of points, neighbors and hypotheses, how they grow (slopes of logarithms), and peak memory;
    this library eager and compiled. On the CPU.

    FOLDER holds speed.md, speed.png and speed.json. A run that was cut off is resumed.

    Exit code 0: everything is there. 2: bad usage.
    """
    from torchreg.benchmark.speed.document import growth_table, times_table
    from torchreg.benchmark.speed.session import Session

    expect_folder(out)
    opt.use(opt.Device.cpu, threads)
    session = Session(out=out, points=counts(points), repeats=repeats, quick=quick)
    rows = session.run(report=complain)
    console = standard_output()
    for text in (times_table(rows), growth_table(rows)):
        console.print(text, soft_wrap=True, markup=False, highlight=False)
    console.print(f"All tables: {legible(str(out / 'speed.md'))}", soft_wrap=True)


def counts(text: str) -> tuple[int, ...]:
    """Ascending counts out of a text with commas between them."""
    words = [word.strip() for word in text.split(",")]
    expect(all(word.isdigit() for word in words), "--points", "counts, a comma between two", text)
    return tuple(sorted({at_least(int(word), "--points", 100) for word in words}))
