"""Tables as Markdown and CSV."""

from __future__ import annotations

import csv
import io
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

_FRAME = 3  # characters about a cell on a terminal


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


def shown_parts(markdown: str) -> list[Table | str]:
    """Paragraphs and tables of a Markdown text, for a terminal; a paragraph that ends with a colon heads its table."""
    parts: list[Table | str] = []
    for block in markdown.strip().split("\n\n"):
        if not block.startswith("|"):
            parts.append(block)
            continue
        head, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines()]
        before = parts[-1] if parts else None
        heading = ""
        if isinstance(before, str) and before.endswith(":"):
            heading = before.removesuffix(":")
            parts.pop()
        parts.append(Table(heading, head, rows))
    return parts


def narrow_parts(table: Table, width: int) -> list[Table]:
    """The table as several of at most ``width`` characters, columns that tell rows apart repeated in each.

    A column takes its longest cell or the longest word of its head, which is broken into lines, and a frame of three
    characters; a column too wide by itself gets a table of its own.
    """
    columns = list(zip(table.head, *table.rows, strict=True))
    widths = [max(*map(len, cells), *map(len, head.split()), 1) + _FRAME for head, *cells in columns]
    if sum(max(len(head) + _FRAME, size) for head, size in zip(table.head, widths, strict=True)) < width:
        return [table]
    heads = [textwrap.fill(head, size - _FRAME) for head, size in zip(table.head, widths, strict=True)]
    keys = len(heads) if sum(widths) < width else _keys(table.rows)
    room = width - 1 - sum(widths[:keys])
    groups: list[list[int]] = [[]]
    for column in range(keys, len(columns)):
        if groups[-1] and sum(widths[c] for c in groups[-1]) + widths[column] > room:
            groups.append([])
        groups[-1].append(column)
    parts = []
    for number, group in enumerate(groups):
        chosen = [*range(keys), *group]
        heading = table.heading if number == 0 else f"{table.heading}, continued".removeprefix(", ")
        rows = [[row[c] for c in chosen] for row in table.rows]
        parts.append(Table(heading, [heads[c] for c in chosen], rows))
    return parts


def _keys(rows: Sequence[Sequence[str]]) -> int:
    """How many of the first columns tell the rows apart."""
    for count in range(1, len(rows[0]) if rows else 1):
        if len({tuple(row[:count]) for row in rows}) == len(rows):
            return count
    return 1


def csv_table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """The same as CSV, a newline at its end."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()
