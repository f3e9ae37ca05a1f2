"""Peak memory of one subject and method, in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

_CODE = """
import json, sys
import torch
from torchreg.benchmark.speed.grid import cells
from torchreg.benchmark.speed.scene import Scenes
key, method, threads = sys.argv[1:]
torch.set_num_threads(int(threads))
cell = next(one for one in cells() if one.key == key)
run = cell.build(Scenes().scene(cell.points, cell.neighbors))[method]
def status(name):
    return next(int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith(name))
open("/proc/self/clear_refs", "w").write("5")  # the peak counts from here
before = status("VmRSS")
run()
print(json.dumps(status("VmHWM") - before))
"""


def can_be_measured() -> bool:
    """Whether this system tells a process its peak."""
    return Path("/proc/self/clear_refs").exists()


def peak_bytes(key: str, method: str, threads: int) -> int:
    """Bytes above what the process held before, of the first run of a cell of the full grid.

    Raises:
        CalledProcessError: the process failed.
    """
    done = subprocess.run(
        [sys.executable, "-c", _CODE, key, method, str(threads)], capture_output=True, text=True, check=True
    )
    found: int = json.loads(done.stdout.strip().splitlines()[-1])
    return found
