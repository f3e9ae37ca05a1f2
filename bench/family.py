"""The tables of docs/benchmarks/family.md, from a finished run of ``torchreg bench family``.

    torchreg bench family --real ../shared/data/real --hard ../shared/data/hard --threads 1 --out DIR
    python bench/family.py DIR

Writes bench/results/family.json (the figures of every fusion by group, with their differences from FPFH alone and from
the default) and docs/benchmarks/family.md.
"""

from __future__ import annotations

import json
from pathlib import Path

from common import bench_parser, in_words, publish, save

from torchreg.benchmark.family.document import scores, sections
from torchreg.benchmark.family.fusions import chosen_fusions


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path, help="the --out of torchreg bench family")
    arguments = parser.parse_args()
    folder = arguments.folder
    whole = json.loads((folder / "family.json").read_text())
    run, rows = whole["run"], whole["rows"]
    if run["quick"]:
        raise SystemExit(f"{folder}: a quick run, whose numbers mean nothing")
    fusions = chosen_fusions(run["fusions"])
    save("family", {"machine": whole["machine"], "run": run, "cells": scores(rows, fusions, run["seed"])})
    taken = "Every pair of both lists" if run["every"] == 1 else f"One pair in {run['every']} of either list"
    most = "" if run["points"] is None else f", thinned to {run['points']:,} points a cloud at most"
    how = "" if run["effort"] == "balanced" else "; poses by matches alone"
    if not arguments.no_docs:
        text = sections(rows, fusions, run["seed"]).replace("\n## ", "\n### ")
        publish("family", f"{taken}{most}{how}.\n\n{text}\n\n{in_words(whole['machine'])}.")


if __name__ == "__main__":
    main()
