"""The paper's experiments in README.md, from a finished run of ``torchreg bench paper``.

    torchreg bench paper --real ../shared/data/real --out DIR && python bench/paper.py DIR

Writes bench/results/paper.json (mean and spread of every cell, the times, the machine), the table in README.md and
docs/paper.png.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

from common import ROOT, in_words, save, table
from readme import put_into_readme

from torchreg.benchmark.paper.layout import overview_table
from torchreg.benchmark.paper.places import GROUPS
from torchreg.benchmark.paper.summary import summarize
from torchreg.benchmark.paper.time_table import added_in_words


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the --out of torchreg bench paper")
    folder = parser.parse_args().folder
    found = json.loads((folder / "paper.json").read_text())
    if found["run"]["quick"]:
        raise SystemExit(f"{folder}: a quick run, whose numbers stand for nothing")
    cells = summarize(found["errors"])
    lines = [
        {
            **dict(zip(("experiment", "setting", "places", "method"), key, strict=True)),
            "found": cell.found,
            "runs": cell.runs,
            **{name: spread._asdict() for name, spread in cell.spreads.items()},
        }
        for key, cell in cells.items()
    ]
    save("paper", {"machine": found["machine"], "run": found["run"], "cells": lines, "times": found["times"]})
    overview = overview_table([group for group in GROUPS if group.paper], cells)
    text = table(overview.head, overview.rows)
    if found["times"]:
        text += f"\n\nExperiment 4: {added_in_words(found['times'])}"
    put_into_readme("paper", f"{text}\n\n{in_words(found['machine'])}.")
    shutil.copy(folder / "figure3_mall.png", ROOT / "docs" / "paper.png")


if __name__ == "__main__":
    main()
