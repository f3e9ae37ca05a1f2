"""Everything about a GPU in one go: its tests, then times and memory, within a given time.

python bench/gpu.py --out DIR               on a machine with a GPU, 8 minutes at most
python bench/gpu.py --out DIR --device cpu --quick --seconds 120    to see how it works

Writes DIR/tests.txt, DIR/speed_device.md and .json, and DIR/summary.json; the latter two in bench/results/gpu.json too,
where a GPU was measured. What the time does not suffice for is left out, and the files say so.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import torch
from common import ROOT, save

SECONDS = 460.0
TESTS_SHARE = 0.4  # of the time, which the tests may take
RESERVE = 20.0  # seconds, to write the tables of a run that had to be ended

_MEASURE = """
import sys, torch
from pathlib import Path
from torchreg.benchmark.core.study import run_study
from torchreg.benchmark.speed.device import DEVICE_POINTS, DeviceRun, device_study
out, device, repeats, quick, seconds = sys.argv[1:]
run = DeviceRun(device=torch.device(device), repeats=int(repeats), quick=quick == "quick", seconds=float(seconds))
run_study(device_study(DEVICE_POINTS, run), Path(out), lambda line: print(line, flush=True))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="the folder of all results")
    parser.add_argument("--device", default="cuda", help="as PyTorch names it")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="that everything may take")
    parser.add_argument("--repeats", type=int, default=5, help="counted runs of everything")
    parser.add_argument("--quick", action="store_true", help="few points, pairs and tests")
    arguments = parser.parse_args()
    end = time.monotonic() + arguments.seconds
    if torch.device(arguments.device).type == "cuda" and not torch.cuda.is_available():
        raise SystemExit(f"--device {arguments.device}: PyTorch {torch.__version__} finds no GPU")
    arguments.out.mkdir(parents=True, exist_ok=True)
    summary: dict[str, Any] = {"device": arguments.device, "tests": tests(arguments)}
    print(f"tests: {summary['tests']}", flush=True)
    summary["measured"] = measure(arguments, end)
    file = arguments.out / "speed_device.json"
    if file.exists():
        summary["speed"] = json.loads(file.read_text())
        print((arguments.out / "speed_device.md").read_text())
    (arguments.out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    if torch.device(arguments.device).type == "cuda" and not arguments.quick:
        save("gpu", summary)


def tests(arguments: argparse.Namespace) -> str:
    """Run the tests of every stage on the device; returns the last line of pytest, or that the time was over."""
    command = [sys.executable, "-W", "error", "-m", "pytest", "-v", "--tb=short", "--device", arguments.device]
    command += ["tests/device/test_stages.py", "-k", "finds_on_a_device", "--durations=15"]
    command += ["-m", "not slow"] if arguments.quick else []
    output = arguments.out / "tests.txt"
    if not _within(command, TESTS_SHARE * arguments.seconds, output):
        return "ended: the time for the tests was over"
    return output.read_text().rstrip().splitlines()[-1]


def measure(arguments: argparse.Namespace, end: float) -> str:
    """Measure in the time that is left; a run that does not end by itself is ended, and its rows are written out."""
    quick = "quick" if arguments.quick else "all"
    words = [str(arguments.out), arguments.device, str(arguments.repeats), quick]
    left = end - time.monotonic()
    log = arguments.out / "speed.txt"
    command = [sys.executable, "-c", _MEASURE, *words]
    if _within([*command, str(max(0.0, left - 2 * RESERVE))], max(1.0, left - RESERVE), log):
        return "to its end"
    _within([*command, "0"], 2 * RESERVE, arguments.out / "speed_ended.txt")
    return "ended: one size took longer than the time that was left"


def _within(command: list[str], seconds: float, output: Path) -> bool:
    """Run a command into a file; returns whether it ended by itself in time."""
    with output.open("w") as file:
        try:
            subprocess.run(command, cwd=ROOT, stdout=file, stderr=subprocess.STDOUT, timeout=seconds, check=False)
        except subprocess.TimeoutExpired:
            return False
    return True


if __name__ == "__main__":
    main()
