"""Files and streams that the commands write to."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import typer
from rich.console import Console

from torchreg.errors import expect, expect_in_words
from torchreg.io.atomic import write_text

STANDARD_OUTPUT = Path("-")


class Output(NamedTuple):
    """A file that an option asks for, and the suffixes it may have (empty: any)."""

    option: str
    path: Path | None
    suffixes: tuple[str, ...] = ()


def check_outputs(outputs: Sequence[Output], inputs: Sequence[Path]) -> None:
    """Check before the work begins that every output can be written and that no two have one path.

    Raises:
        ValueError: another suffix, no such folder, a folder of that name, or a path that is an input or another
            output; the message names the option.
    """
    taken = {os.path.realpath(path): "an input" for path in inputs}
    for option, path, suffixes in outputs:
        if path is None or path == STANDARD_OUTPUT:
            continue
        known = not suffixes or path.suffix.lower() in suffixes
        expect(known, option, "a name that ends in " + " or ".join(suffixes), os.fspath(path))
        expect(path.absolute().parent.is_dir(), option, "a file in a folder that exists", os.fspath(path))
        expect_in_words(not path.is_dir(), option, "a file", f"the folder {os.fspath(path)}")
        real = os.path.realpath(path)
        expect_in_words(real not in taken, option, "a file of its own", f"{os.fspath(path)}, {taken.get(real)}")
        taken[real] = f"which {option} writes too"


def write_json(path: Path, content: dict[str, object], *, through_link: bool = True) -> None:
    """Write JSON to a file, as ``atomic_write`` does, or to standard output for ``-``."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    if path == STANDARD_OUTPUT:
        typer.echo(text, nl=False)
        return
    write_text(path, text, through_link=through_link)


def standard_output(*, stderr: bool = False) -> Console:
    """A console for tables, or for standard error: no colors off a terminal, nothing in the text read as markup."""
    return Console(stderr=stderr, markup=False, highlight=False, emoji=False)
