"""Rows of several ways to do one thing, measured in turn, and their table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Any

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.tables import markdown_table
from torchreg.benchmark.core.timing import interleaved, spread

PATIENCE = 60.0
"""Seconds for the counted runs of one function; the first one is always counted."""


def side_by_side(part: str, case: str, runs: Mapping[str, Callable[[], Any]], repeats: int) -> Row:
    """A row: ``seconds`` of every way by its name; the first one is what the others are compared with."""
    return {"part": part, "case": case, "seconds": interleaved(runs, repeats, patience=PATIENCE)}


def of_part(rows: Sequence[Row], part: str) -> list[Row]:
    """The rows of one part of the study, ``"stages"`` where a row names none."""
    return [row for row in rows if row.get("part", "stages") == part]


def table_of_part(rows: Sequence[Row], part: str) -> str:
    """The table of one part, or an empty text where none of its rows is measured."""
    lines = []
    for row in of_part(rows, part):
        first = median(next(iter(row["seconds"].values())))
        for name, seconds in row["seconds"].items():
            memory = row.get("bytes", {}).get(name)
            lines.append([row["case"], name, spread(seconds), f"{first / median(seconds):.1f}", in_bytes(memory)])
    return markdown_table(["", "", "seconds", "times as fast as the first", "peak memory"], lines) if lines else ""


def in_bytes(count: int | None) -> str:
    """Bytes in the unit that fits, or an empty text."""
    if count is None:
        return ""
    return f"{count / 2**30:.2f} GiB" if count >= 2**30 else f"{count / 2**20:.0f} MiB"
