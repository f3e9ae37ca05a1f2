"""The field on the real pairs beside the checkout: ``torchreg bench field``, its JSON and its table in README.md.

    python bench/real_pairs.py                         every method and pair; goes on where it was cut off
    python bench/real_pairs.py --methods default,fast  only these; README.md stays as it is

Rows go to build/field, as ``torchreg bench field --out`` keeps them; bench/results/field.json is what they come to.
"""

from __future__ import annotations

import argparse
import shutil

from common import REAL, RESULTS, ROOT, in_words, machine, table
from readme import put_into_readme

from torchreg.benchmark.field.document import tables
from torchreg.benchmark.field.session import Session

OUT = ROOT / "build" / "field"
SHOWN = ("All pairs", "Registration recall by errors")
"""Tables that go into README.md."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", help="only these, a comma between two")
    arguments = parser.parse_args()
    if not REAL.exists():
        raise SystemExit(f"the real pairs are not there: {REAL.relative_to(ROOT.parent)} beside the checkout")
    OUT.parent.mkdir(exist_ok=True)
    names = None if arguments.methods is None else tuple(arguments.methods.split(","))
    findings = Session(data=REAL, out=OUT, methods=names).run(lambda line: print(line, flush=True))
    text = "\n\n".join(table(one.head, one.rows) for one in tables(findings) if one.heading in SHOWN)
    print(text)
    if names is None:
        shutil.copy(OUT / "field.json", RESULTS / "field.json")
        titles = {method.name: method.title for method in findings.methods}
        gaps = "".join(f" {titles[name]}: {why}." for name, why in findings.gaps.items())
        put_into_readme("real pairs", f"{text}\n\n{in_words(machine())}.{gaps}")


if __name__ == "__main__":
    main()
