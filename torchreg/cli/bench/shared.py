"""What the commands of ``torchreg bench`` share: options, the run of a study, and what a terminal shows of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from torchreg.benchmark.core.study import Study, run_study
from torchreg.benchmark.core.tables import narrow_parts
from torchreg.benchmark.peers import METHODS
from torchreg.benchmark.peers.comparison import ComparisonOptions
from torchreg.cli import options as opt
from torchreg.cli.guard import complain
from torchreg.cli.output import standard_output
from torchreg.errors import at_least, expect
from torchreg.report.text import legible

Out = Annotated[
    Path,
    typer.Option(
        "--out",
        metavar="FOLDER",
        help="Folder of all results: NAME.md, CSV, NAME.json, pictures. An unfinished run there is resumed.",
    ),
]
Log = Annotated[
    Path | None,
    typer.Option(
        "--log",
        metavar="NAME|FOLDER",
        help="The log that lists the pairs: the name of a file in each scene or beside it, or a folder with "
        "SCENE/gt.log for each, as 3DLoMatch comes; gt.log by default.",
    ),
]
Quick = Annotated[bool, typer.Option("--quick", help="Run a small part, within seconds, to see how it works.")]


@dataclass(frozen=True, kw_only=True)
class ComparisonRun:
    """Which methods are compared on which scenes, and how they run."""

    methods: Annotated[
        str | None,
        typer.Option(
            "--methods",
            metavar="NAME,NAME",
            help=f"Only these: {', '.join(METHODS)}.",
        ),
    ] = None
    scenes: Annotated[
        str | None, typer.Option("--scenes", metavar="NAME,NAME", help="Only the pairs of these scenes.")
    ] = None
    quick: Quick = False
    seed: opt.Seed = 0
    device: opt.DeviceName = opt.Device.cpu
    threads: opt.Threads = None

    def options(self) -> ComparisonOptions:
        """The same for a study; sets PyTorch's threads.

        Raises:
            ValueError: a GPU is asked for and PyTorch finds none.
        """
        return ComparisonOptions(
            methods=names_in(self.methods),
            scenes=names_in(self.scenes),
            quick=self.quick,
            device=opt.use(self.device, self.threads).type,
            seed=self.seed,
        )


def run_and_show(study: Study, out: Path) -> None:
    """Run, and print what the study shows and where the rest lies."""
    from rich.table import Table

    rows = run_study(study, out, report=complain)
    console = standard_output()
    for shown in study.shown(rows):
        if isinstance(shown, str):
            console.print(shown)
            continue
        for part in narrow_parts(shown, console.width):
            table = Table(*part.head, title=part.heading or None, title_justify="left")
            for row in part.rows:
                table.add_row(*row)
            console.print(table)
    console.print(f"All tables: {legible(str(out / study.name))}.md", soft_wrap=True)


def expect_folder(out: Path) -> None:
    """Raise ``ValueError`` where ``--out`` is neither a folder nor a name for one in a folder that exists."""
    fits = out.is_dir() or (not out.exists() and out.absolute().parent.is_dir())
    expect(fits, "--out", "a folder, or a name for one in a folder that exists", str(out))


def names_in(text: str | None) -> tuple[str, ...] | None:
    """Names out of a text with commas between them."""
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())


def counts_in(text: str, option: str, lowest: int) -> tuple[int, ...]:
    """Ascending counts out of a text with commas between them, each at least ``lowest``."""
    words = [word.strip() for word in text.split(",")]
    expect(all(word.isdigit() for word in words), option, "counts, a comma between two", text)
    return tuple(sorted({at_least(int(word), option, lowest) for word in words}))
