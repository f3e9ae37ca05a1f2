"""The tables of docs/benchmarks/site.md, from a finished run of ``torchreg bench site``.

    torchreg bench site --data ../shared/data/hard/sites --data ../shared/data/real --out DIR
    python bench/site.py DIR

Writes bench/results/site.json and docs/benchmarks/site.md.
"""

from __future__ import annotations

import json
from pathlib import Path

from common import bench_parser, in_words, publish, save

from torchreg.benchmark.site.document import sections
from torchreg.benchmark.site.registry import chosen_site_methods


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("folder", type=Path, help="the --out of torchreg bench site")
    arguments = parser.parse_args()
    folder = arguments.folder
    run = json.loads((folder / "site.json").read_text())
    if run["run"]["quick"]:
        raise SystemExit(f"{folder}: a quick run, whose numbers mean nothing")
    save("site", run)
    if not arguments.no_docs:
        methods = chosen_site_methods(run["run"]["methods"])
        publish("site", f"{sections(run['rows'], methods)}\n\n{in_words(run['machine'])}.")


if __name__ == "__main__":
    main()
