"""What the commands of ``torchreg bench`` share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.errors import expect

Out = Annotated[
    Path,
    typer.Option("--out", metavar="FOLDER", help="Folder of all results; an unfinished run there is resumed."),
]
Methods = Annotated[
    str | None,
    typer.Option(
        "--methods",
        metavar="NAME,NAME",
        help="Compare only these methods: open3d-100k, open3d-600k, open3d-600k-all, open3d-fgr, kiss-matcher, "
        "gc-ransac, magsac, default, fast, thorough, paper, fpfh.",
    ),
]
Scenes = Annotated[
    str | None, typer.Option("--scenes", metavar="NAME,NAME", help="Take only the pairs of these scenes.")
]


def names_of(text: str | None) -> tuple[str, ...] | None:
    """The names in a text with commas between them; ``None`` for none."""
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())


def expect_folder(out: Path) -> None:
    """Raise ``ValueError`` where ``--out`` is neither a folder nor a name for one in a folder that exists."""
    fits = out.is_dir() or (not out.exists() and out.absolute().parent.is_dir())
    expect(fits, "--out", "a folder, or a name for one in a folder that exists", str(out))
