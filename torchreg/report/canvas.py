"""Blank figures, limits, annotations and legends, and figures as files."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from torchreg.errors import expect
from torchreg.io.atomic import atomic_write
from torchreg.report.text import legible

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
"""The kinds of files that ``save_figure`` writes."""


def blank_figure(size: tuple[float, float], title: str, *, fontsize: float, columns: int) -> Figure:
    """An empty figure of this size (inches) on the Agg canvas, made without pyplot; its title wraps after ``columns``.

    matplotlib is imported here, when the first picture is drawn.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(textwrap.fill(legible(title), columns), fontsize=fontsize, parse_math=False)
    return figure


def annotate(ax: Axes, text: str, place: tuple[float, float], **style: Any) -> None:  # noqa: ANN401
    """Write on a panel, on white so that points do not hide it."""
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    ax.annotate(text, place, bbox=paper, **style)


def set_limits(ax: Axes, low: NDArray[Any], high: NDArray[Any], ratio: float) -> None:
    """Show at least from ``low`` to ``high`` (2,), to scale, in a panel ``ratio`` times as high as wide."""
    size = high - low
    shown = np.array([max(size[0], size[1] / ratio), max(size[1], size[0] * ratio)])
    middle = (low + high) / 2
    ax.set_xlim(middle[0] - shown[0] / 2, middle[0] + shown[0] / 2)
    ax.set_ylim(middle[1] - shown[1] / 2, middle[1] + shown[1] / 2)
    ax.set_aspect("equal")


def add_legend(figure: Figure, colors: Mapping[str, str], *others: Artist, title: str | None = None) -> None:
    """Name the colors of dots below a figure, and then other marks; ``title`` is a line above the names."""
    from matplotlib.lines import Line2D

    style: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 7}
    handles = [*(Line2D([], [], color=color, label=name, **style) for name, color in colors.items()), *others]
    below_figure(figure, handles=handles, title=title, ncols=len(handles))


def below_figure(figure: Figure, **legend: Any) -> None:  # noqa: ANN401
    """A legend without a frame below a figure; ``legend`` as matplotlib's ``Figure.legend`` takes it."""
    style: dict[str, Any] = {"frameon": False, "fontsize": 10, "title_fontsize": 9}
    figure.legend(loc="outside lower center", **style, **legend)


def save_figure(figure: Figure, path: str | os.PathLike[str], *, dpi: float = 130) -> None:
    """Write a figure as PNG, PDF or SVG, in full or not at all.

    Args:
        figure: a matplotlib figure.
        path: a name that ends in ``.png``, ``.pdf`` or ``.svg``, in a folder that exists.
        dpi: pixels per inch; in PDF and SVG of the points alone, which are drawn as an image.

    Raises:
        ValueError: another suffix, or no such folder.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.report import registration_figure, save_figure
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> save_figure(registration_figure(pair.source, pair.target, pair.T_target_source), "ab.png")
    """
    suffix = Path(path).suffix.lower()
    expect(suffix in FIGURE_SUFFIXES, "path", "a name that ends in " + ", ".join(FIGURE_SUFFIXES), os.fspath(path))
    with atomic_write(path) as file:
        figure.savefig(file, format=suffix[1:], dpi=dpi)
