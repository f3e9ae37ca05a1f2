"""A page of HTML on one pair, in a single file that opens without a network."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from torchreg.errors import at_least, expect, expect_in_words
from torchreg.io.atomic import write_text
from torchreg.metrics import PoseErrors
from torchreg.report.page.markup import escaped
from torchreg.report.page.reported import reported_pair
from torchreg.report.page.sections import SECTIONS, Section
from torchreg.report.page.viewer import viewer_style
from torchreg.types import Clouds, RegistrationResult
from torchreg.version import __version__

REPORT_SUFFIXES = (".html", ".htm")
"""The kinds of files that ``write_report`` writes."""

_ALLOWED = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
_STYLE = Path(__file__).with_name("page.css")


def write_report(
    path: str | os.PathLike[str],
    result: RegistrationResult,
    source: Clouds,
    target: Clouds,
    pair: int = 0,
    *,
    names: tuple[str, str] = ("source", "target"),
    words: tuple[str, str] | None = None,
    file_notes: Sequence[str] = (),
    truth: PoseErrors | None = None,
    max_points: int = 40_000,
) -> None:
    """Write ``report_html`` of these arguments to a file, in full or not at all.

    Args:
        path: a name that ends in ``.html`` or ``.htm``, in a folder that exists.
        result: of B pairs.
        source: the B clouds that were registered, as they were given to ``register``.
        target: likewise.
        pair: which one.
        names: of source and target, short, for the title and the headings.
        words: of source and target for the table; by default the names and the numbers of points.
        file_notes: what reading the clouds showed.
        truth: errors under the true transform, where it is known.
        max_points: of each cloud in the 3D view.

    Raises:
        ValueError: another suffix, no such folder, another number of clouds or other origins than the result's, a
            ``pair`` out of range, or a count below 1.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.report import write_report
        >>> scans = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> result = tr.register(scans.source, scans.target)
        >>> write_report("mall.html", result, scans.source, scans.target)  # doctest: +SKIP
    """
    suffix = Path(path).suffix.lower()
    expect(suffix in REPORT_SUFFIXES, "path", "a name that ends in " + " or ".join(REPORT_SUFFIXES), os.fspath(path))
    text = report_html(
        *(result, source, target, pair),
        names=names,
        words=words,
        file_notes=file_notes,
        truth=truth,
        max_points=max_points,
    )
    write_text(path, text)


def report_html(
    result: RegistrationResult,
    source: Clouds,
    target: Clouds,
    pair: int = 0,
    *,
    names: tuple[str, str] = ("source", "target"),
    words: tuple[str, str] | None = None,
    file_notes: Sequence[str] = (),
    truth: PoseErrors | None = None,
    max_points: int = 40_000,
    sections: Sequence[Section] = SECTIONS,
) -> str:
    """Describe one pair in a page of HTML that holds its pictures, its 3D view, styles and scripts.

    It names the verdict, numbers, transform, candidates, options and versions. Of a refused pair it shows the likeliest
    pose, marked as refused. Nothing is fetched from anywhere, which the page also forbids itself. The same result and
    clouds give the same text.

    Args:
        result: as ``write_report`` takes it, as are the others but the last.
        source: likewise.
        target: likewise.
        pair: likewise.
        names: likewise.
        words: likewise.
        file_notes: likewise.
        truth: likewise.
        max_points: likewise.
        sections: functions from the pair to markup, from top to bottom.

    Returns:
        The page.

    Raises:
        ValueError: as ``write_report``, but for the path.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.report import report_html
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> result = tr.register(pair.source, pair.target, effort="plain")
        >>> "<title>" in report_html(result, pair.source, pair.target, names=("a.ply", "b.ply"))
        True
    """
    at_least(max_points, "max_points", 1)
    for name, clouds in (("source", source), ("target", target)):
        expected = f"the {len(result)} clouds that were registered"
        expect_in_words(len(clouds) == len(result), name, expected, f"{len(clouds)} clouds")
    reported = reported_pair(
        *(result, source, target, pair),
        names=names,
        words=words,
        file_notes=file_notes,
        truth=truth,
        max_points=max_points,
    )
    return page_html(f"torchreg: {reported.heading}", [section(reported) for section in sections])


def page_html(title: str, parts: Sequence[str]) -> str:
    """A page with this title that holds pieces of markup, styles and scripts; empty pieces are left out."""
    return "\n".join(
        (
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_ALLOWED}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escaped(title)}</title>",
            f"<style>\n{_STYLE.read_text(encoding='utf-8')}{viewer_style()}</style>",
            "</head>",
            "<body>",
            f"<header><h1>{escaped(title)}</h1></header>",
            "<main>",
            *(part for part in parts if part),
            "</main>",
            f"<footer>Made by torchreg {escaped(__version__)}. This page holds all it shows.</footer>",
            "</body>",
            "</html>",
            "",
        )
    )
