"""What the benchmarks share: the folders, results as JSON, and what ``torchreg.benchmark`` measures with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torchreg.benchmark.machine import in_words, machine
from torchreg.benchmark.tables import markdown_table as table
from torchreg.benchmark.timing import interleaved, spread

__all__ = ["REAL", "RESULTS", "ROOT", "in_words", "interleaved", "machine", "save", "spread", "table"]

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "bench" / "results"
REAL = ROOT.parent / "shared" / "data" / "real"


def save(name: str, content: dict[str, Any]) -> Path:
    """Write ``bench/results/NAME.json``."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path
