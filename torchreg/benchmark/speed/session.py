"""One run of the speed benchmark into a folder: time what is missing, then write table, chart and JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchreg.benchmark.machine import in_words, machine
from torchreg.benchmark.rows import Row, Rows
from torchreg.benchmark.speed.chart import draw
from torchreg.benchmark.speed.document import markdown
from torchreg.benchmark.speed.grid import POINTS, STAGES, Cell, cells
from torchreg.benchmark.speed.memory import can_be_measured, peak_bytes
from torchreg.benchmark.speed.scene import Scenes
from torchreg.benchmark.timing import interleaved
from torchreg.errors import expect
from torchreg.io.atomic import atomic_write

PATIENCE = 60.0
"""Seconds for the counted runs of one function; the first one is always counted."""

QUICK_POINTS = (500, 2_000)
_WEIGHED = ("FPFH + PCFH with search", "whole pair")  # whose peak memory is measured


@dataclass(frozen=True, kw_only=True)
class Session:
    """What is to be run.

    Attributes:
        out: the folder of results; made where it is not there.
        points: of each cloud, one scene each.
        repeats: counted runs of everything.
        quick: few points and two repeats, no peak memory: to see how it works.
    """

    out: Path
    points: tuple[int, ...] = POINTS
    repeats: int = 5
    quick: bool = False

    def __post_init__(self) -> None:
        most = max(POINTS)
        expect(max(self.points) <= most, "points", f"at most {most:,}, which a simulated scan holds", self.points)

    def run(self, report: Callable[[str], None] = lambda _: None) -> list[Row]:
        """Time what the folder does not hold yet, and write all files anew.

        Args:
            report: is told what is being done, in a few words.

        Returns:
            A row per cell: its sizes, ``seconds`` by method, and ``bytes`` by method where measured.

        Raises:
            ValueError: the folder holds results of other settings.
        """
        self.out.mkdir(parents=True, exist_ok=True)
        facts = machine()
        rows = Rows(self.out, self._manifest(facts))
        scenes, asked = Scenes(), list(cells(QUICK_POINTS if self.quick else self.points))
        for cell in asked:
            if cell.key not in rows:
                report(cell.words)
                rows.add(self._measured(cell, scenes))
        found = [rows[cell.key] for cell in asked]
        self._write(found, facts)
        return found

    def _measured(self, cell: Cell, scenes: Scenes) -> Row:
        runs = cell.build(scenes.scene(cell.points, cell.neighbors))
        seconds = interleaved(runs, 2 if self.quick else self.repeats, patience=PATIENCE)
        row: Row = {
            "key": cell.key,
            "subject": cell.subject,
            "points": cell.points,
            "neighbors": cell.neighbors,
            "hypotheses": cell.hypotheses,
            "seconds": seconds,
        }
        if cell.subject in _WEIGHED and not self.quick and can_be_measured():
            threads = torch.get_num_threads()
            row["bytes"] = {method: peak_bytes(cell.key, method, threads) for method in runs}
        return row

    def _write(self, rows: list[Row], facts: dict[str, Any]) -> None:
        whole = {"machine": facts, "run": self._manifest(facts), "rows": rows}
        if any(row["subject"] in STAGES for row in rows):
            draw(rows, self.out / "speed.png")
        for name, content in {
            "speed.json": json.dumps(whole, indent=1) + "\n",
            "speed.md": f"# Speed\n\n{markdown(rows)}\n\n{in_words(facts)}.\n",
        }.items():
            with atomic_write(self.out / name) as file:
                file.write(content.encode())

    def _manifest(self, facts: dict[str, Any]) -> dict[str, Any]:
        """What every row depends on."""
        versions = {name: facts[name] for name in ("torchreg", "torch", "open3d", "processor", "threads")}
        return {**versions, "repeats": self.repeats, "quick": self.quick}
