"""A figure as a file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from torchreg.errors import expect
from torchreg.io.atomic import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
"""The kinds of files that ``save_figure`` writes."""


def save_figure(figure: Figure, path: str | os.PathLike[str], *, dpi: float = 130) -> None:
    """Write a figure as PNG, PDF or SVG, in full or not at all.

    Args:
        figure: a matplotlib figure.
        path: a name that ends in ``.png``, ``.pdf`` or ``.svg``, in a folder that exists.
        dpi: pixels per inch; in PDF and SVG of the points alone, which are drawn as an image.

    Raises:
        ValueError: another suffix, or no such folder.
    """
    suffix = Path(path).suffix.lower()
    expect(suffix in FIGURE_SUFFIXES, "path", "a name that ends in " + ", ".join(FIGURE_SUFFIXES), os.fspath(path))
    with atomic_write(path) as file:
        figure.savefig(file, format=suffix[1:], dpi=dpi)
