"""Tables as Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import NamedTuple


class Table(NamedTuple):
    """One table of texts, with its heading."""

    heading: str
    head: list[str]
    rows: list[list[str]]

    @property
    def section(self) -> str:
        """A Markdown section: heading and table."""
        return f"## {self.heading}\n\n{markdown_table(self.head, self.rows)}"


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, without a newline at its end."""
    lines = ["| " + " | ".join(head) + " |", "|" + "|".join("---" for _ in head) + "|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def csv_table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """The same as CSV, a newline at its end."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()
