"""Peak memory of a piece of code, measured in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

CAN_MEASURE = Path("/proc/self/clear_refs").exists()
"""Whether this system counts the peak memory of a process."""

_CODE = """
import json
import torch
import torchreg as tr
from torchreg.open3d_loader import load_open3d
load_open3d()
def status(name):
    return next(int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith(name))
{make}
open("/proc/self/clear_refs", "w").write("5")  # the peak counts from here
before = status("VmRSS")
{work}
print(json.dumps({{"bytes": status("VmHWM") - before, **globals().get("more", {{}})}}))
"""


def run_python(*arguments: str) -> Any:  # noqa: ANN401
    """The JSON that another Python process prints last.

    Raises:
        CalledProcessError: the process failed.
    """
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=True)
    return json.loads(done.stdout.strip().splitlines()[-1])


def peak_bytes(make: str, work: str) -> dict[str, Any]:
    """Peak memory of a piece of code in another process.

    Args:
        make: code that prepares; the memory that it keeps is not counted.
        work: code that is measured. It may put further JSON values into a dict ``more``.

    Returns:
        ``bytes`` above what the process held before, and the values of ``more``.

    Raises:
        CalledProcessError: the process failed.
    """
    content: dict[str, Any] = run_python("-c", _CODE.format(make=make, work=work))
    return content
