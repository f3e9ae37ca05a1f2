"""The commands under one name."""

from __future__ import annotations

from typing import Annotated

import typer

from torchreg.cli.batch import batch
from torchreg.cli.bench import bench
from torchreg.cli.check import check
from torchreg.cli.convert import convert
from torchreg.cli.demo import demo
from torchreg.cli.guard import GuardedGroup
from torchreg.cli.info import info
from torchreg.cli.register import register
from torchreg.cli.site import site
from torchreg.cli.train import train
from torchreg.cli.verify import verify
from torchreg.version import __version__

app = typer.Typer(
    cls=GuardedGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
app.command()(register)
app.command()(verify)
app.command()(batch)
app.command()(site)
app.command()(check)
app.command()(info)
app.command()(convert)
app.command()(demo)
app.command()(train)
app.add_typer(bench, name="bench")


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"torchreg {__version__}")
        raise typer.Exit


@app.callback()
def torchreg(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Register colored point clouds without a first guess: geometric and color features, mutual matches, robust poses.

    Exit codes: 0, the pair is registered, or the transform is right; 2, bad usage, or a file that cannot be read; 3,
    the pair is refused, or the transform is not right. The help of batch and site says what theirs mean.
    """
