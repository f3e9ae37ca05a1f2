"""The tables of docs/benchmarks/paper.md, from a finished run of ``torchreg bench paper``.

    torchreg bench paper --real ../shared/data/real --out DIR && python bench/paper.py DIR

Writes bench/results/paper.json (every cell and difference with its intervals, the machine), the tables in
docs/benchmarks/paper.md, docs/paper.png and docs/paper_differences.png; of Experiment 4, which wants a quiet machine,
bench/results/paper_times.json and its lines in the same page. Where ``--experiment`` left the one or the other out,
what was published of it before stays.

A run that was stopped is finished for the places it has by asking for no more of them: ``--seeds COUNT``.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from common import DOCS, bench_parser, in_words, publish, save, table

from torchreg.benchmark.core.tables import Table
from torchreg.benchmark.paper.intervals import difference_table, overview_table
from torchreg.benchmark.paper.places import GROUPS
from torchreg.benchmark.paper.summary import differences_of, summarize
from torchreg.benchmark.paper.tables import added_in_words
from torchreg.benchmark.paper.ways import MAIN_WAYS

PICTURES = {"figure3_mall.png": "paper.png", "differences.png": "paper_differences.png"}


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path, help="the --out of torchreg bench paper")
    arguments = parser.parse_args()
    folder = arguments.folder
    run = json.loads((folder / "paper.json").read_text())
    if run["run"]["quick"]:
        raise SystemExit(f"{folder}: a quick run, whose numbers mean nothing")
    if run["errors"]:
        errors(run, folder, published=not arguments.no_docs)
    if run["times"]:
        save("paper_times", {"machine": run["machine"], "run": run["run"], "times": run["times"]})
        if not arguments.no_docs:
            publish("paper times", f"{added_in_words(run['times'])}\n\n{in_words(run['machine'])}.")


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
        for made, name in PICTURES.items():
            shutil.copy(folder / made, DOCS / name)


def text(shown: Table) -> str:
    return table(shown.head, shown.rows)


if __name__ == "__main__":
    main()
