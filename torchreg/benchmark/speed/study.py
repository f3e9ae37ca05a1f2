"""The study of times and peak memory of every stage."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch

from torchreg.benchmark.core.memory import CAN_MEASURE, peak_bytes
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell, Picture, Study
from torchreg.benchmark.core.timing import interleaved
from torchreg.benchmark.speed.document import draw, growth_table, markdown, times_table
from torchreg.benchmark.speed.grid import POINTS, TimedCell, cells
from torchreg.benchmark.speed.scene import Scenes
from torchreg.errors import expect

PATIENCE = 60.0
"""Seconds for the counted runs of one function; the first one is always counted."""

QUICK_POINTS = (500, 2_000)
QUICK_REPEATS = 2
_WITH_MEMORY = ("FPFH + PCFH with search", "whole pair")  # subjects whose peak memory is measured

_MAKE_RUN = """
from torchreg.benchmark.speed.grid import cells
from torchreg.benchmark.speed.scene import Scenes
torch.set_num_threads({threads})
cell = next(one for one in cells() if one.key == {key!r})
run = cell.build(Scenes().scene(cell.points, cell.neighbors))[{method!r}]
"""


def speed_study(points: Sequence[int] = POINTS, *, repeats: int = 5, quick: bool = False) -> Study:
    """The study of times and peak memory, torchreg against Open3D, on the CPU.

    Args:
        points: of each cloud, one scene each.
        repeats: counted runs of everything.
        quick: few points, two repeats, no peak memory: to see how it works.

    Raises:
        ValueError: more points than a simulated scan holds.
    """
    expect(max(points) <= max(POINTS), "points", f"at most {max(POINTS):,}, which a simulated scan holds", points)
    scenes = Scenes()
    listed = list(cells(QUICK_POINTS if quick else tuple(points)))
    return Study(
        name="speed",
        cells=[Cell(cell.key, cell.key, partial(_measured, cell, scenes, repeats, quick)) for cell in listed],
        settings={"repeats": repeats, "quick": quick},
        versions=("torchreg", "torch", "open3d", "processor", "threads"),
        document=_document,
        draw=draw,
        shown=lambda rows: [times_table(rows), growth_table(rows)],
    )


def _measured(cell: TimedCell, scenes: Scenes, repeats: int, quick: bool) -> Row:
    """A row: the sizes of the cell, ``seconds`` by method, and ``bytes`` by method where measured."""
    runs = cell.build(scenes.scene(cell.points, cell.neighbors))
    row: Row = {
        "subject": cell.subject,
        "points": cell.points,
        "neighbors": cell.neighbors,
        "hypotheses": cell.hypotheses,
        "seconds": interleaved(runs, QUICK_REPEATS if quick else repeats, patience=PATIENCE),
    }
    if cell.subject in _WITH_MEMORY and not quick and CAN_MEASURE:
        threads = torch.get_num_threads()
        made = {method: _MAKE_RUN.format(threads=threads, key=cell.key, method=method) for method in runs}
        row["bytes"] = {method: peak_bytes(code, "run()")["bytes"] for method, code in made.items()}
    return row


def _document(rows: list[Row], pictures: Sequence[Picture], machine: str) -> str:
    return "\n\n".join(["# Speed", markdown(rows), *(picture.markdown for picture in pictures), machine]) + "\n"
