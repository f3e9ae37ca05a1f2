"""Speed in README.md, from a finished run of ``torchreg bench speed``.

    torchreg bench speed --out DIR && python bench/speed.py DIR

Writes bench/results/speed.json, the tables in README.md and docs/speed.png.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

from common import ROOT, in_words, save
from readme import put_into_readme

from torchreg.benchmark.speed.document import markdown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the --out of torchreg bench speed")
    folder = parser.parse_args().folder
    found = json.loads((folder / "speed.json").read_text())
    if found["run"]["quick"]:
        raise SystemExit(f"{folder}: a quick run, whose numbers stand for nothing")
    save("speed", found)
    shutil.copy(folder / "speed.png", ROOT / "docs" / "speed.png")
    put_into_readme("speed", f"{markdown(found['rows'])}\n\n{in_words(found['machine'])}.")


if __name__ == "__main__":
    main()
