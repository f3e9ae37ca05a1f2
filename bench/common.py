"""What the benchmarks share: the machine in words, results as JSON, tables as Markdown."""

from __future__ import annotations

import json
import platform
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import torch

import torchreg as tr
from torchreg.open3d_loader import load_open3d

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "bench" / "results"
REAL = ROOT.parent / "shared" / "data" / "real"


def machine() -> dict[str, Any]:
    """Versions, processor, threads and commit: what a figure depends on."""
    ask = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(ask, cwd=ROOT, capture_output=True, text=True, check=False)
    model = next(
        (line.split(":", 1)[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")),
        platform.processor(),
    )
    return {
        "torchreg": tr.__version__,
        "torch": torch.__version__,
        "open3d": load_open3d().__version__,
        "python": platform.python_version(),
        "processor": model,
        "threads": torch.get_num_threads(),
        "commit": commit.stdout.strip() or None,
    }


def in_words(facts: dict[str, Any]) -> str:
    """One line under a table."""
    return (
        f"{facts['processor']}, {facts['threads']} threads, torch {facts['torch']}, Open3D {facts['open3d']}, "
        f"torchreg {facts['torchreg']} at {facts['commit']}"
    )


def save(name: str, content: dict[str, Any]) -> Path:
    """Write ``bench/results/NAME.json``."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "|".join("---" for _ in head) + "|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def timed(run: Callable[[], Any], repeats: int = 5) -> list[float]:
    """Seconds of ``repeats`` runs after one warm-up, sorted."""
    run()
    found = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        found.append(time.perf_counter() - begin)
    return sorted(found)


def interleaved(runs: dict[str, Callable[[], Any]], repeats: int = 5) -> dict[str, list[float]]:
    """Seconds of several functions run in turn after a warm-up of each, so that drift hits all alike."""
    for run in runs.values():
        run()
    found: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            begin = time.perf_counter()
            run()
            found[name].append(time.perf_counter() - begin)
    return found


def spread(seconds: Sequence[float]) -> str:
    """Median and range, in the unit that fits."""
    scale, unit = (1e3, "ms") if median(seconds) < 1 else (1.0, "s")
    return f"{median(seconds) * scale:.3g} {unit} ({min(seconds) * scale:.3g} to {max(seconds) * scale:.3g})"


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text().splitlines()
    except OSError:
        return []
