"""What the commands of ``torchreg bench`` share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.errors import expect

Out = Annotated[
    Path,
    typer.Option("--out", metavar="FOLDER", help="Where all results go (a path); the same command goes on from there."),
]


def expect_folder(out: Path) -> None:
    """Raise ``ValueError`` where ``--out`` is neither a folder nor a name for one in a folder that exists."""
    fits = out.is_dir() or (not out.exists() and out.absolute().parent.is_dir())
    expect(fits, "--out", "a folder, or a name for one in a folder that exists", str(out))
