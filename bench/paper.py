"""The tables of docs/benchmarks/paper.md, from a run of ``torchreg bench paper``.

    torchreg bench paper --real ../shared/data/real --out DIR && python bench/paper.py DIR

Writes bench/results/paper.json (every cell and difference with its intervals, the machine), the tables in
docs/benchmarks/paper.md, docs/paper.png and docs/paper_differences.png; of Experiment 4, which wants a quiet machine,
bench/results/paper_times.json and its lines in the same page. Where ``--experiment`` left the one or the other out,
what was published of it before stays.

A run that is not finished is published as far as it is, from DIR/rows.jsonl; its tables say over how many places.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from common import DOCS, bench_parser, in_words, machine, publish, save, table

from torchreg.benchmark.core.tables import Table
from torchreg.benchmark.paper.differences_chart import differences_chart
from torchreg.benchmark.paper.intervals import difference_table, overview_table
from torchreg.benchmark.paper.places import GROUPS
from torchreg.benchmark.paper.summary import differences_of, errors_of, summarize, times_of
from torchreg.benchmark.paper.tables import added_in_words
from torchreg.benchmark.paper.ways import MAIN_WAYS
from torchreg.report import save_figure

FIGURE = "figure3_mall.png"  # of a finished run


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path, help="the --out of torchreg bench paper")
    arguments = parser.parse_args()
    folder = arguments.folder
    run = read(folder)
    if run["run"]["quick"]:
        raise SystemExit(f"{folder}: a quick run, whose numbers mean nothing")
    if run["errors"]:
        errors(run, folder, published=not arguments.no_docs)
    if run["times"]:
        save("paper_times", {"machine": run["machine"], "run": run["run"], "times": run["times"]})
        if not arguments.no_docs:
            publish("paper times", f"{added_in_words(run['times'])}\n\n{in_words(run['machine'])}.")


def read(folder: Path) -> dict[str, Any]:
    """What a finished run wrote, or the same of the rows that an unfinished one has."""
    if (folder / "paper.json").exists():
        return json.loads((folder / "paper.json").read_text())
    whole = (folder / "rows.jsonl").read_text().split("\n")[:-1]  # without the torn last line of a killed run
    manifest, *rows = map(json.loads, whole)
    return {"machine": machine(), "run": manifest, "errors": errors_of(rows), "times": times_of(rows)}


def errors(run: dict[str, Any], folder: Path, *, published: bool) -> None:
    """Everything but the times."""
    cells, differences = summarize(run["errors"]), differences_of(run["errors"])
    content = {
        "machine": run["machine"],
        "run": run["run"],
        "cells": [
            {
                **key._asdict(),
                "places": cell.places,
                "found": cell.found._asdict(),
                "rmse": cell.rmse._asdict(),
                **{name: spread._asdict() for name, spread in cell.spreads.items()},
            }
            for key, cell in cells.items()
        ],
        "differences": [
            {
                **key._asdict(),
                "places": change.places,
                "found": {**change.found._asdict(), "verdict": change.found_verdict},
                "rmse": {**change.rmse._asdict(), "verdict": change.rmse_verdict},
            }
            for key, change in differences.items()
        ],
    }
    save("paper", content)
    if published:
        groups = [group for group in GROUPS if group.paper]
        publish("paper differences", text(difference_table(groups, MAIN_WAYS, differences)))
        overview = text(overview_table(groups, MAIN_WAYS, cells))
        publish("paper", f"{overview}\n\n{in_words(run['machine'])}.")
        there = [group for group in groups if any(key.group == group.name for key in differences)]
        save_figure(differences_chart(there, MAIN_WAYS, differences), DOCS / "paper_differences.png")
        if (folder / FIGURE).exists():
            shutil.copy(folder / FIGURE, DOCS / "paper.png")


def text(shown: Table) -> str:
    return table(shown.head, shown.rows)


if __name__ == "__main__":
    main()
