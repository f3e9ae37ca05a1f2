"""Pieces of HTML. What comes in as text is escaped here; what these functions return is markup."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from torchreg.report.text import legible

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI = 110


def escaped(text: str) -> str:
    r"""Text from outside as markup, also inside quotes; what cannot be printed as ``\x1b``."""
    return html.escape(legible(text), quote=True)


def section(heading: str, *body: str) -> str:
    """A part of the page under a heading of the second level; nothing where the body is empty."""
    content = "\n".join(part for part in body if part)
    return f"<section>\n<h2>{escaped(heading)}</h2>\n{content}\n</section>" if content else ""


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph, with a class for the style sheet where ``kind`` names one."""
    return f'<p class="{escaped(kind)}">{escaped(text)}</p>' if kind else f"<p>{escaped(text)}</p>"


def listing(items: Iterable[str]) -> str:
    """A list with a dot before each text; nothing where there is none."""
    rows = "".join(f"<li>{escaped(item)}</li>\n" for item in items)
    return f"<ul>\n{rows}</ul>" if rows else ""


def preformatted(text: str) -> str:
    """Text in a fixed width, with its line breaks."""
    return f"<pre>{escaped(text)}</pre>"


def folded(summary: str, body: str) -> str:
    """Markup that opens on a click."""
    return f"<details>\n<summary>{escaped(summary)}</summary>\n{body}\n</details>"


def named_rows(rows: Iterable[tuple[str, str]]) -> str:
    """A table of names and values; a value of several lines is set in a fixed width."""
    lines = []
    for name, value in rows:
        cell = preformatted(value) if "\n" in value else escaped(value)
        lines.append(f'<tr><th scope="row">{escaped(name)}</th><td>{cell}</td></tr>')
    return _table("named", lines)


def columns(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with a heading over each column."""
    head = "".join(f'<th scope="col">{escaped(heading)}</th>' for heading in headings)
    lines = ["<tr>" + "".join(f"<td>{escaped(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    return _table("columns", [f"<tr>{head}</tr>", *lines])


def picture(figure: Figure, description: str) -> str:
    """A matplotlib figure as a PNG image inside the page, with a text for those who cannot see it."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=_DPI)
    content = base64.b64encode(file.getvalue()).decode()
    return f'<img src="data:image/png;base64,{content}" alt="{escaped(description)}">'


def _table(kind: str, lines: Sequence[str]) -> str:
    return f'<div class="wide"><table class="{kind}">\n' + "\n".join(lines) + "\n</table></div>"
