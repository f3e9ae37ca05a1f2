"""Whole methods on real pairs, on a quiet machine and beside another process that keeps one core busy."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from statistics import median

from torchreg.benchmark.core.real_pairs import RealPair, read_real_pairs
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell
from torchreg.benchmark.core.tables import markdown_table
from torchreg.benchmark.core.timing import seconds_of, spread
from torchreg.benchmark.peers import METHODS
from torchreg.benchmark.peers.method import Task
from torchreg.benchmark.speed.side_by_side import of_part
from torchreg.io import read_cloud
from torchreg.preprocess import voxel_downsample

BUSY = "busy"
CAPTION = (
    "Whole methods on real pairs, voxel means at hand, in turn on a quiet machine and beside a process that keeps one "
    "core busy: medians over the pairs of each pair's median, and of the ratios pair by pair:"
)

_COMPARED = ("default", "fast", "open3d-600k", "kiss-matcher")
_PEERS = ("open3d-600k", "kiss-matcher")
_STATES = ("quiet", "busy")
_SPIN = "print(flush=True)\nwhile True: pass"


def cells(data: Path, repeats: int, *, quick: bool) -> Iterator[Cell]:
    """One row per pair of the list; a quick run takes the first pair.

    Raises:
        CloudFileError: the list cannot be read.
    """
    for pair in read_real_pairs(data)[: 1 if quick else None]:
        yield Cell(f"busy, {pair.name}", f"quiet and busy, {pair.name}", partial(_measured, pair, repeats))


@contextmanager
def busy_core() -> Iterator[None]:
    """Another process runs within this context and keeps one core busy; it ends with the context."""
    with subprocess.Popen([sys.executable, "-c", _SPIN], stdout=subprocess.PIPE) as process:
        try:
            if process.stdout is not None:
                process.stdout.readline()  # it spins now
            yield
        finally:
            process.kill()


def table(rows: Sequence[Row]) -> str:
    """Every method quiet and busy, and how much longer each peer takes, or an empty text without rows."""
    measured = of_part(rows, BUSY)
    if not measured:
        return ""

    def typical(row: Row, method: str, state: str) -> float:
        return float(median(row["seconds"][state][method]))

    names = list(measured[0]["seconds"]["quiet"])
    lines = []
    for name in names:
        times = [spread([typical(row, name, state) for row in measured]) for state in _STATES]
        slower = median(typical(row, name, "busy") / typical(row, name, "quiet") for row in measured)
        ratios = [
            f"{median(typical(row, peer, state) / typical(row, name, state) for row in measured):.2f}"
            for peer in _PEERS
            if peer in names
            for state in _STATES
        ]
        lines.append([METHODS[name].title, *times, f"{slower:.2f}", *ratios])
    faster = [f"{METHODS[peer].title} takes, {state}" for peer in _PEERS if peer in names for state in _STATES]
    return markdown_table([f"real pairs: {len(measured)}", *_STATES, "busy / quiet", *faster], lines)


def _measured(pair: RealPair, repeats: int) -> Row:
    """A row: ``seconds`` by state and method, every method in turn, the states in turn."""
    clouds = [voxel_downsample(read_cloud(file), pair.voxel) for file in (pair.source, pair.target)]
    task = Task(source=clouds[0], target=clouds[1], voxel=pair.voxel)
    runs = {name: partial(METHODS[name].run, task) for name in _COMPARED if not METHODS[name].gap()}
    seconds: dict[str, dict[str, list[float]]] = {state: {name: [] for name in runs} for state in _STATES}
    for run in runs.values():  # to warm up
        run()
    for _ in range(repeats):
        for state in _STATES:
            with busy_core() if state == "busy" else nullcontext():
                for name, run in runs.items():
                    seconds[state][name].append(seconds_of(run))
    return {"part": BUSY, "case": pair.name, "seconds": seconds}
