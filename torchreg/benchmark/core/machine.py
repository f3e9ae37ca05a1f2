"""What a figure depends on: versions, processor, threads and commit."""

from __future__ import annotations

import platform
import subprocess
from pathlib import Path
from typing import Any

import torch

from torchreg.open3d_loader import load_open3d
from torchreg.version import __version__

_HERE = Path(__file__).resolve().parent


def machine() -> dict[str, Any]:
    """Versions, processor, threads and, in a checkout, its commit."""
    ask = ["git", "rev-parse", "--short", "HEAD"]
    try:
        commit = subprocess.run(ask, cwd=_HERE, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        commit = ""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "torchreg": __version__,
        "torch": torch.__version__,
        "open3d": load_open3d().__version__,
        "python": platform.python_version(),
        "processor": models[0] if models else platform.processor(),
        "threads": torch.get_num_threads(),
        "commit": commit or None,
    }


def in_words(facts: dict[str, Any]) -> str:
    """One line under a table."""
    return (
        f"{facts['processor']}, {facts['threads']} threads, torch {facts['torch']}, Open3D {facts['open3d']}, "
        f"torchreg {facts['torchreg']} at {facts['commit']}"
    )
