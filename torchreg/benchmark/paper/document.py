"""The tables as one Markdown document and as CSV."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from torchreg.benchmark.paper import captions
from torchreg.benchmark.paper.layout import Table, error_table, overview_table
from torchreg.benchmark.paper.places import GROUPS, Group
from torchreg.benchmark.paper.printed import ERRORS, SECONDS
from torchreg.benchmark.paper.settings import TABLES
from torchreg.benchmark.paper.summary import MEASURES, summarize
from torchreg.benchmark.paper.time_table import added, time_table
from torchreg.benchmark.rows import Row
from torchreg.benchmark.tables import csv_table, markdown_table


class Findings(NamedTuple):
    """Everything measured: rows of Experiments 1, 2, 3 and 5, rows of Experiment 4, and whether it was a quick run."""

    errors: Sequence[Row]
    times: Sequence[Row]
    quick: bool


class Picture(NamedTuple):
    """A file beside the document, and what it shows."""

    experiment: int
    file: str
    caption: str


def tables(findings: Findings) -> dict[int, list[Table]]:
    """The tables by the paper's number, a letter behind it where several groups of places fill the same one."""
    cells = summarize(findings.errors)
    made: dict[int, list[Table]] = {}
    for experiment, table in TABLES.items():
        groups = [group for group in _groups(findings, experiment) if group.paper]
        parts = [""] if len(groups) == 1 else list("abcdef")
        own = [error_table(experiment, group, cells, part) for group, part in zip(groups, parts, strict=False)]
        if experiment == 4 and findings.times:
            own = [time_table(findings.times)]
        if own:
            made[table] = own
    return made


def overview(findings: Findings) -> Table:
    """Pairs found and median RMSE everywhere, stations apart included."""
    return overview_table(GROUPS, summarize(findings.errors))


def markdown(findings: Findings, machine: str, pictures: Sequence[Picture]) -> str:
    """The whole document.

    Args:
        findings: what was measured.
        machine: in words, for the last line.
        pictures: each stands behind the tables of its experiment.
    """
    parts = ["# The paper's experiments"]
    parts += [captions.QUICK] if findings.quick else []
    parts += [captions.SETUP, captions.DEVIATIONS]
    real = {group.name for group in GROUPS if group.real}
    parts += [captions.REAL] if any(row["group"] in real for row in findings.errors) else []
    made = tables(findings)
    for experiment, number in TABLES.items():
        for table in made.get(number, []):
            parts += [f"## {table.name}: {table.heading}", _text(table)]
        parts += [captions.TIMES] if experiment == 4 and number in made else []
        parts += [f"![{one.caption}]({one.file})\n\n{one.caption}" for one in pictures if one.experiment == experiment]
    if findings.errors:
        table = overview(findings)
        parts += [f"## {table.name}: {table.heading}", _text(table)]
    return "\n\n".join([*parts, machine]) + "\n"


def csv_files(findings: Findings) -> dict[str, str]:
    """One CSV for each of the paper's tables, a line for every number: what it is, the paper's, ours with spread."""
    files = {}
    head = ["experiment", "setting", "places", "method", "measure"]
    head += ["paper", "mean", "standard_deviation", "median", "least", "most", "found", "runs"]
    lines: dict[int, list[list[object]]] = {}
    for (experiment, setting, group, method), cell in summarize(findings.errors).items():
        printed = ERRORS.get((experiment, setting, method))
        for measure in MEASURES:
            paper = getattr(printed, measure, None)
            names = [experiment, setting, group, method, measure]
            lines.setdefault(TABLES[experiment], []).append(
                [*names, paper, *cell.spreads[measure], cell.found, cell.runs]
            )
    for table, own in lines.items():
        files[f"table{table}.csv"] = csv_table(head, own)
    if findings.times:
        files["table8.csv"] = _time_csv(findings.times)
    return files


def _time_csv(rows: Sequence[Row]) -> str:
    head = ["setting", "points", "span", "method", "paper_seconds", "added_by_pcfh", "round", "seconds"]
    lines: list[list[object]] = []
    for row in rows:
        for name, seconds in row["seconds"].items():
            span, method = name.split("/", 1)
            paper = SECONDS[row["setting"], method]
            same = [row["setting"], row["points"], span, method, paper, added(row, span)]
            lines += [[*same, i, s] for i, s in enumerate(seconds)]
    return csv_table(head, lines)


def _groups(findings: Findings, experiment: int) -> list[Group]:
    there = {row["group"] for row in findings.errors if row["experiment"] == experiment}
    return [group for group in GROUPS if group.name in there]


def _text(table: Table) -> str:
    return markdown_table(table.head, table.rows)
