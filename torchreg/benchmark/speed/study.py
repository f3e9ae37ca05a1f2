"""The study of times and peak memory: every stage, batches, large things, and whole methods beside a busy process."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch

from torchreg.benchmark.core.memory import CAN_MEASURE, peak_bytes
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell, Picture, Study
from torchreg.benchmark.core.tables import shown_parts
from torchreg.benchmark.core.timing import interleaved
from torchreg.benchmark.speed import batches, busy, large
from torchreg.benchmark.speed.document import draw, markdown
from torchreg.benchmark.speed.grid import POINTS, TimedCell, cells
from torchreg.benchmark.speed.scene import Scenes
from torchreg.benchmark.speed.side_by_side import PATIENCE
from torchreg.errors import expect

QUICK_POINTS = (500, 2_000)
QUICK_HYPOTHESES = (1_000, 5_000)
QUICK_REPEATS = 2
_WITH_MEMORY = ("FPFH + PCFH with search", "whole pair")  # subjects whose peak memory is measured

_MAKE_RUN = """
from torchreg.benchmark.speed.grid import cells
from torchreg.benchmark.speed.scene import Scenes
from torchreg.benchmark.speed.side_by_side import PATIENCE
torch.set_num_threads({threads})
cell = next(one for one in cells() if one.key == {key!r})
run = cell.build(Scenes().scene(cell.points, cell.neighbors))[{method!r}]
"""


def speed_study(
    points: Sequence[int] = POINTS, *, repeats: int = 5, quick: bool = False, data: Path | None = None
) -> Study:
    """The study of times and peak memory, torchreg against Open3D, on the CPU.

    Args:
        points: of each cloud, one scene each.
        repeats: counted runs of everything.
        quick: few points, pairs and matches, two repeats, no peak memory: to see how it works.
        data: a list of real pairs, or its folder: whole methods run on them, quiet and beside a busy process.

    Raises:
        ValueError: more points than a simulated scan holds.
        CloudFileError: the list cannot be read.
    """
    expect(max(points) <= max(POINTS), "points", f"at most {max(POINTS):,}, which a simulated scan holds", points)
    scenes = Scenes()
    repeats = QUICK_REPEATS if quick else repeats
    listed = [
        Cell(cell.key, cell.key, partial(_measured, cell, scenes, repeats, quick))
        for cell in (cells(QUICK_POINTS, QUICK_HYPOTHESES) if quick else cells(tuple(points)))
    ]
    listed += [*batches.cells(repeats, quick=quick), *large.cells(repeats, quick=quick)]
    if data is not None:
        listed += busy.cells(data, repeats, quick=quick)
    return Study(
        name="speed",
        cells=listed,
        settings={"repeats": repeats, "quick": quick},
        versions=("torchreg", "torch", "open3d", "processor", "threads"),
        document=_document,
        draw=draw,
        shown=lambda rows: shown_parts(markdown(rows)),
        remarks=() if data is not None else ("quiet against busy is measured with --data alone",),
    )


def _measured(cell: TimedCell, scenes: Scenes, repeats: int, quick: bool) -> Row:
    """A row: the sizes of the cell, ``seconds`` by method, and ``bytes`` by method where measured."""
    runs = cell.build(scenes.scene(cell.points, cell.neighbors))
    row: Row = {
        "subject": cell.subject,
        "points": cell.points,
        "neighbors": cell.neighbors,
        "hypotheses": cell.hypotheses,
        "seconds": interleaved(runs, repeats, patience=PATIENCE),
    }
    if cell.subject in _WITH_MEMORY and not quick and CAN_MEASURE:
        threads = torch.get_num_threads()
        made = {method: _MAKE_RUN.format(threads=threads, key=cell.key, method=method) for method in runs}
        row["bytes"] = {method: peak_bytes(code, "run()")["bytes"] for method, code in made.items()}
    return row


def _document(rows: list[Row], pictures: Sequence[Picture], machine: str) -> str:
    return "\n\n".join(["# Speed", markdown(rows), *(picture.markdown for picture in pictures), machine]) + "\n"
