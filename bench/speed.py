"""The tables of docs/benchmarks/speed.md, from a finished run of ``torchreg bench speed``.

    torchreg bench speed --out DIR && python bench/speed.py DIR

Writes bench/results/speed.json, docs/benchmarks/speed.md and docs/speed.png.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from common import DOCS, bench_parser, in_words, publish, save

from torchreg.benchmark.speed.document import markdown


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path, help="the --out of torchreg bench speed")
    arguments = parser.parse_args()
    folder = arguments.folder
    run = json.loads((folder / "speed.json").read_text())
    if run["run"]["quick"]:
        raise SystemExit(f"{folder}: a quick run, whose numbers mean nothing")
    save("speed", run)
    if not arguments.no_docs:
        publish("speed", f"{markdown(run['rows'])}\n\n{in_words(run['machine'])}.")
        shutil.copy(folder / "speed.png", DOCS / "speed.png")


if __name__ == "__main__":
    main()
