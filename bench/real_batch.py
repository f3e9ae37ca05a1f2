"""All real pairs through ``torchreg batch``: the command as a user runs it, and its summary.

    python bench/real_batch.py            writes bench/results/real_batch.json and docs/benchmarks/batch.md

The pairs file names both clouds, the truth, and the voxel edge of the scene; everything else is the default.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import REAL, bench_parser, in_words, listed_pairs, machine, publish, save


def main() -> None:
    arguments = bench_parser(__doc__).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        pairs, out = Path(folder) / "pairs.csv", Path(folder) / "out"
        (Path(folder) / "real").symlink_to(REAL)  # so that results name no folder of this machine
        write_pairs(pairs)
        command = [sys.executable, "-m", "torchreg", "batch", str(pairs), "--out", str(out)]
        begin = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        first = time.perf_counter() - begin
        begin = time.perf_counter()
        subprocess.run(command, capture_output=True, text=True, check=True)
        again = time.perf_counter() - begin
        summary = json.loads((out / "summary.json").read_text())
        lines = json.loads((out / "results.json").read_text())
    facts = machine()
    output = "\n".join(line.rstrip() for line in done.stdout.rstrip().splitlines())
    text = (
        f"```\n{output}\n```\n\n{len(lines)} pairs of {summary['clouds']} clouds in {first:.0f} s, the start of all "
        f"processes included; the same command once more, with nothing left to do, {again:.1f} s ({in_words(facts)})."
    )
    print(text)
    save("real_batch", {"machine": facts, "seconds": first, "again": again, "summary": summary, "pairs": lines})
    if not arguments.no_docs:
        publish("real batch", text)


def write_pairs(path: Path) -> None:
    """The real pairs as a pairs file."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["name", "source", "target", "truth", "voxel", "scene"])
        for pair in listed_pairs():
            truth = " ".join(str(number) for row in pair["T"] for number in row)
            clouds = [f"real/{pair[side]}" for side in ("source", "target")]
            writer.writerow([pair["name"], *clouds, truth, pair["voxel_m"], pair["scene"]])


if __name__ == "__main__":
    main()
