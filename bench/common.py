"""What the benchmarks share: folders, results as JSON, tables into the documents, the real pairs."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchreg.benchmark.core.machine import in_words, machine
from torchreg.benchmark.core.memory import peak_bytes, run_python
from torchreg.benchmark.core.tables import markdown_table as table
from torchreg.benchmark.core.timing import interleaved, spread

__all__ = [
    "DOCS",
    "HARD",
    "MADE",
    "REAL",
    "RESULTS",
    "ROOT",
    "bench_parser",
    "in_words",
    "interleaved",
    "listed_pairs",
    "machine",
    "peak_bytes",
    "publish",
    "run_python",
    "save",
    "spread",
    "table",
]

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
RESULTS = ROOT / "bench" / "results"
REAL = ROOT.parent / "shared" / "data" / "real"
HARD = ROOT.parent / "shared" / "data" / "hard"
MADE = ROOT.parent / "shared" / "cases" / "made_pairs.py"


def bench_parser(description: str | None) -> argparse.ArgumentParser:
    """The options of a benchmark: its docstring as help, and --no-docs."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-docs", action="store_true", help="leave the documents as they are")
    return parser


def save(name: str, content: dict[str, Any]) -> Path:
    """Write ``bench/results/NAME.json``."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path


def publish(block: str, text: str) -> None:
    """Replace what stands between ``<!-- begin: BLOCK -->`` and ``<!-- end: BLOCK -->``.

    The block is in one of ``docs/**/*.md`` or in README.md, so that no number there is typed by hand.
    """
    begin, end = f"<!-- begin: {block} -->", f"<!-- end: {block} -->"
    pages = [page for page in (ROOT / "README.md", *sorted(DOCS.rglob("*.md"))) if begin in page.read_text()]
    if len(pages) != 1 or pages[0].read_text().count(end) != 1:
        raise SystemExit(f"expected one page with {begin} and {end}, got {len(pages)}")
    before, rest = pages[0].read_text().split(begin)
    pages[0].write_text(f"{before}{begin}\n{text}\n{end}{rest.split(end)[1]}")


def listed_pairs(folder: Path = REAL) -> Sequence[dict[str, Any]]:
    """The real pairs in a folder beside the checkout, as their list has them."""
    if not folder.exists():
        raise SystemExit(f"the real pairs are not there: {folder.relative_to(ROOT.parent)} beside the checkout")
    return json.loads((folder / "pairs.json").read_text())["pairs"]
