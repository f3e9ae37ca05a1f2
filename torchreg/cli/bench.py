"""``torchreg bench``: measurements that anyone can repeat. Each is a command in a module of its own."""

from __future__ import annotations

import typer

from torchreg.cli.bench_3dmatch import threedmatch
from torchreg.cli.bench_field import field
from torchreg.cli.bench_paper import paper
from torchreg.cli.bench_speed import speed
from torchreg.cli.guard import GuardedGroup

bench = typer.Typer(
    cls=GuardedGroup,
    no_args_is_help=True,
    help="Measure how well and how fast it registers, each command on data of its own.",
)
bench.command()(field)
bench.command()(paper)
bench.command()(speed)
bench.command("3dmatch")(threedmatch)


@bench.callback()
def _group() -> None:
    """Keep a group of one command a group."""
