"""The field on the real pairs beside the checkout: ``torchreg bench field``, its JSON and its tables in the documents.

    python bench/real_pairs.py                         every method and pair; an unfinished run is resumed
    python bench/real_pairs.py --methods default,fast  only these; the documents stay as they are
    python bench/real_pairs.py --five                  the five of README.md, whose rows alone are written
    python bench/real_pairs.py --saved                 the tables from bench/results/field.json, nothing measured

Rows go to build/field (of ``--five`` to build/field/five), as ``torchreg bench field --out`` keeps them. Written:
bench/results/field.json, the tables of docs/benchmarks/real_pairs.md, and the five rows of README.md; by ``--five``
bench/results/field_five.json and these rows.
"""

from __future__ import annotations

import json
import shutil

from common import REAL, RESULTS, ROOT, bench_parser, in_words, listed_pairs, publish, table

from torchreg.benchmark.core.study import run_study
from torchreg.benchmark.field.document import tables
from torchreg.benchmark.field.study import field_study
from torchreg.benchmark.field.summary import summarize
from torchreg.benchmark.peers import METHODS
from torchreg.benchmark.peers.comparison import ComparisonOptions, MethodComparison

OUT = ROOT / "build" / "field"
PAGE_TABLES = ("All pairs", "Registration recall by errors")
README_METHODS = ("open3d-600k", "kiss-matcher", "magsac", "fast", "default")


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--methods", help="only these, a comma between two")
    parser.add_argument("--five", action="store_true", help="those of README.md, and its rows alone")
    parser.add_argument("--saved", action="store_true", help="write the documents from saved results, nothing measured")
    arguments = parser.parse_args()
    names = None if arguments.methods is None else tuple(arguments.methods.split(","))
    file = "field_five.json" if arguments.five else "field.json"
    out = OUT / "five" if arguments.five else OUT
    if not arguments.saved:
        listed_pairs()
        out.mkdir(parents=True, exist_ok=True)
        options = ComparisonOptions(methods=README_METHODS if arguments.five else names)
        run_study(field_study(REAL, options), out, lambda line: print(line, flush=True))
        if names is None:
            shutil.copy(out / "field.json", RESULTS / file)
    content = json.loads((RESULTS / file if arguments.saved else out / "field.json").read_text())
    methods = [METHODS[name] for name in content["run"]["methods"]]
    comparison = MethodComparison(content["rows"], methods, content["gaps"], content["run"]["seed"])
    text = "\n\n".join(table(one.head, one.rows) for one in tables(comparison) if one.heading in PAGE_TABLES)
    print(text)
    if names is not None or arguments.no_docs:
        return
    if not arguments.five:
        gaps = "".join(f" {METHODS[name].title}: {why}." for name, why in comparison.gaps.items())
        publish("real pairs", f"{text}\n\n{in_words(content['machine'])}.{gaps}")
    publish("five methods", f"{readme_table(comparison)}\n\n{in_words(content['machine'])}.")


def readme_table(comparison: MethodComparison) -> str:
    """Five methods by what matters most."""
    rows = []
    for name in README_METHODS:
        cell = summarize(comparison.of(METHODS[name]), comparison.seed)
        rows.append(
            [
                METHODS[name].title,
                f"{round(cell.recall.value * cell.pairs)} of {cell.pairs}",
                "-" if cell.inlier_ratio is None else f"{cell.inlier_ratio.value:.2f}",
                "-" if cell.rre_deg is None else f"{cell.rre_deg.value:.2f} deg, {cell.rte_m.value:.3f} m",
                f"{cell.seconds.value:.2f} s",
                str(cell.wrong_called_right),
                str(cell.right_refused),
            ]
        )
    head = ["method", "pairs found", "right matches", "median errors", "median time"]
    head += ["wrong, called right", "right, refused"]
    return table(head, rows)


if __name__ == "__main__":
    main()
