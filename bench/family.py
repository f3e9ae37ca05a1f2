"""The tables of docs/benchmarks/family.md, from finished runs of ``torchreg bench family``.

    torchreg bench family --real ../shared/data/real --hard ../shared/data/hard --threads 1 --out DIR
    python bench/family.py DIR [DIR ...]

Several runs stand one after the other, such as all descriptors on some pairs and few of them on all pairs. Writes
bench/results/family.json (the figures of every fusion by group, with their differences from FPFH alone and from the
default) and docs/benchmarks/family.md.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from common import bench_parser, in_words, publish, save

from torchreg.benchmark.family.document import CAPTION, scores, tables
from torchreg.benchmark.family.fusions import chosen_fusions


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("folders", type=Path, nargs="+", help="the --out of torchreg bench family")
    arguments = parser.parse_args()
    parts, kept = [CAPTION], []
    for folder in arguments.folders:
        whole = json.loads((folder / "family.json").read_text())
        run, rows = whole["run"], whole["rows"]
        if run["quick"]:
            raise SystemExit(f"{folder}: a quick run, whose numbers mean nothing")
        fusions = chosen_fusions(run["fusions"])
        kept.append({"machine": whole["machine"], "run": run, "cells": scores(rows, fusions, run["seed"])})
        shown = [table.section.replace("## ", "### ", 1) for table in tables(rows, fusions, run["seed"])]
        parts += [f"## {what(run, rows)}", *shown, f"{in_words(whole['machine'])}."]
    save("family", {"runs": kept})
    if not arguments.no_docs:
        publish("family", "\n\n".join(parts))


def what(run: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """How many pairs were measured, and how."""
    pairs = len({(row["list"], row["pair"]) for row in rows})
    of_scenes = len({(row["list"], row["scene"]) for row in rows})
    how = "poses by matches alone" if run["effort"] == "plain" else "all that register does"
    most = "clouds as listed" if run["points"] is None else f"clouds of {run['points']:,} points at most"
    return f"{pairs} pairs of {of_scenes} scenes, {how}, {most}"


if __name__ == "__main__":
    main()
