"""The tables of docs/benchmarks/paper.md, from a finished run of ``torchreg bench paper``.

    torchreg bench paper --real ../shared/data/real --out DIR && python bench/paper.py DIR

Writes bench/results/paper.json (mean and spread of every cell, the times, the machine), the table in
docs/benchmarks/paper.md and docs/paper.png.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from common import DOCS, bench_parser, in_words, publish, save, table

from torchreg.benchmark.paper.places import GROUPS
from torchreg.benchmark.paper.tables import added_in_words, overview_table, summarize


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path, help="the --out of torchreg bench paper")
    arguments = parser.parse_args()
    folder = arguments.folder
    run = json.loads((folder / "paper.json").read_text())
    if run["run"]["quick"]:
        raise SystemExit(f"{folder}: a quick run, whose numbers mean nothing")
    cells = summarize(run["errors"])
    lines = [
        {
            **dict(zip(("experiment", "setting", "places", "method"), key, strict=True)),
            "found": cell.found,
            "runs": cell.runs,
            **{name: spread._asdict() for name, spread in cell.spreads.items()},
        }
        for key, cell in cells.items()
    ]
    save("paper", {"machine": run["machine"], "run": run["run"], "cells": lines, "times": run["times"]})
    overview = overview_table([group for group in GROUPS if group.paper], cells)
    text = table(overview.head, overview.rows)
    if run["times"]:
        text += f"\n\nExperiment 4: {added_in_words(run['times'])}"
    if not arguments.no_docs:
        publish("paper", f"{text}\n\n{in_words(run['machine'])}.")
        shutil.copy(folder / "figure3_mall.png", DOCS / "paper.png")


if __name__ == "__main__":
    main()
