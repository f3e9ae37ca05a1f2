"""The study of a GPU: every stage, the whole pair and its memory over points, pairs a second over sizes of batches.

Every run ends with a synchronization, so that what is timed is the work and not its launch. Sizes that do not fit the
memory or the time are skipped, and their rows say so.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any

import torch

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell, Picture, Study
from torchreg.benchmark.core.tables import markdown_table, shown_parts
from torchreg.benchmark.core.timing import interleaved, spread
from torchreg.benchmark.speed.batches import small_pairs
from torchreg.benchmark.speed.device_peers import PEERS
from torchreg.benchmark.speed.device_scene import device_scene
from torchreg.benchmark.speed.device_stages import OURS, STAGES, DeviceStage
from torchreg.benchmark.speed.side_by_side import in_bytes
from torchreg.benchmark.speed.subjects import Run
from torchreg.registration.register import register
from torchreg.types import Clouds

DEVICE_POINTS = (10_000, 100_000, 1_000_000, 10_000_000)
PAIRS = (1, 4, 16, 64, 256, 1024, 4096)
QUICK_POINTS, QUICK_PAIRS = (500, 2_000), (1, 4)
PAIR_POINTS, QUICK_PAIR_POINTS = 1_000, 200
SECONDS = 400.0
"""The time that a run may take where none is given."""

_SHARE = 0.15  # of the time that is left: what a cell may be expected to take
_RUNS = 4  # of ours at least: two to warm up, one for the memory, one that counts
_EFFORTS = ("fast", "balanced")

CAPTION = (
    "Points between neighboring points of a scan of a simulated mall. Stages take what earlier stages made, on the "
    "device. Medians of synchronized runs after a warm-up, least and most in brackets; peak memory above what was held "
    "before. Batches are pairs of random choices of two such scans, in one call."
)


@dataclass(frozen=True, eq=False, kw_only=True)
class DeviceRun:
    """How a device is measured."""

    device: torch.device
    repeats: int = 5  # counted runs of everything
    seconds: float = SECONDS  # that all of it may take
    quick: bool = False  # few points and pairs


class Budget:
    """The time that is left, and the seconds that each series of cells took at its last size."""

    def __init__(self, seconds: float) -> None:
        self._end = time.monotonic() + seconds
        self._last: dict[str, tuple[int, float]] = {}

    @property
    def left(self) -> float:
        """Seconds."""
        return self._end - time.monotonic()

    def refusal(self, series: str, size: int, power: float) -> str:
        """Why the next size of a series is not measured, or an empty text.

        ``power`` is the exponent by which its cost is expected to grow.
        """
        if self.left <= 0:
            return "the time is over"
        before, took = self._last.get(series, (size, 0.0))
        if took == float("inf"):
            return "a smaller size did not fit"
        expected = took * (size / before) ** power
        return f"would take about {expected:.0f} s" if expected > _SHARE * self.left else ""

    def note(self, series: str, size: int, took: float) -> None:
        """Keep what a cell took, infinite where it did not fit."""
        self._last[series] = (size, took)


def device_study(points: Sequence[int], run: DeviceRun) -> Study:
    """The study of one device; the time counts from here.

    Args:
        points: of each cloud, one scene each.
        run: how it is measured.
    """
    budget = Budget(run.seconds)
    return Study(
        name="speed_device",
        cells=list(_cells(QUICK_POINTS if run.quick else points, run, budget)),
        settings={"repeats": run.repeats, "quick": run.quick, "device": device_name(run.device)},
        versions=("torchreg", "torch", "processor", "threads"),
        document=lambda rows, pictures, machine: _document(rows, pictures, f"{device_name(run.device)}; {machine}"),
        shown=lambda rows: shown_parts(markdown(rows)),
        device=str(run.device),
    )


def device_name(device: torch.device) -> str:
    """What a GPU is called, or the name of another device."""
    return torch.cuda.get_device_name(device) if device.type == "cuda" else str(device)


def markdown(rows: Sequence[Row]) -> str:
    """Both tables, and a list of what was skipped."""
    parts = [CAPTION, _times(rows), _pairs_a_second(rows)]
    skipped = [f"- {row['key']}: {row['skipped']}" for row in rows if "skipped" in row]
    skipped += [f"- {row['key']}, {name}: {why}" for row in rows for name, why in row.get("failed", {}).items()]
    return "\n\n".join(
        [part for part in parts if part] + (["Not measured:\n\n" + "\n".join(skipped)] if skipped else [])
    )


def _cells(points: Sequence[int], run: DeviceRun, budget: Budget) -> Iterator[Cell]:
    """The smaller sizes of everything first."""
    pairs = QUICK_PAIRS if run.quick else PAIRS
    each = max(1, len(pairs) // len(points))
    for number, count in enumerate(points):
        for name, stage in STAGES.items():
            key = f"{name}, {count:,} points"
            yield Cell(key, key, partial(_stage_row, name, stage, count, run, budget))
        last = number == len(points) - 1
        for size in pairs[number * each : None if last else (number + 1) * each]:
            for effort in _EFFORTS:
                key = f"{size:,} pairs, {effort}"
                yield Cell(key, key, partial(_batch_row, size, effort, run, budget))


def _stage_row(name: str, stage: DeviceStage, points: int, run: DeviceRun, budget: Budget) -> Row:
    """``seconds`` by method, ``bytes`` of ours, ``failed`` peers, or ``skipped``."""

    def runs() -> dict[str, Run]:
        scene = device_scene(points, run.device)
        ours = {OURS: stage.build(scene)}
        ours[OURS]()  # makes what it takes from earlier stages
        return ours | {
            peer.name: peer.stages[name](scene) for peer in PEERS if name in peer.stages and not peer.gap(run.device)
        }

    row: Row = {"part": "stages", "case": name, "points": points}
    return row | _measured(name, points, stage.power, runs, run, budget)


def _batch_row(pairs: int, effort: str, run: DeviceRun, budget: Budget) -> Row:
    def runs() -> dict[str, Run]:
        few, points = min(pairs, max(PAIRS) // 16), QUICK_PAIR_POINTS if run.quick else PAIR_POINTS
        sides = small_pairs(few, points)
        source, target = (Clouds.pack([side] * (pairs // few)).to(run.device) for side in sides)
        return {OURS: lambda: register(source, target, effort=effort)}

    row: Row = {"part": "batches", "case": effort, "pairs": pairs}
    return row | _measured(f"batches, {effort}", pairs, 1.0, runs, run, budget)


def _measured(
    series: str, size: int, power: float, make: Callable[[], dict[str, Run]], run: DeviceRun, budget: Budget
) -> Row:
    why = budget.refusal(series, size, power)
    if why:
        return {"skipped": why}
    try:
        runs = {name: _synchronized(one, run.device) for name, one in make().items()}
        peak = _peak(runs[OURS], run.device)
    except torch.OutOfMemoryError as error:
        budget.note(series, size, float("inf"))
        return {"skipped": f"does not fit the memory: {str(error).splitlines()[0]}"}
    finally:
        _free(run.device)
    failed, working = {}, {OURS: runs[OURS]}
    for name, one in runs.items():
        if name != OURS:
            try:
                one()
            except Exception as error:  # whatever a peer raises, our own rows are wanted
                failed[name] = f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
            else:
                working[name] = one
    patience = max(0.0, _SHARE * budget.left / len(working))
    row: Row = {"seconds": interleaved(working, run.repeats, patience=patience), "bytes": peak, "failed": failed}
    _free(run.device)
    budget.note(series, size, _RUNS * median(row["seconds"][OURS]))
    return row


def _synchronized(run: Run, device: torch.device) -> Run:
    def timed() -> Any:  # noqa: ANN401
        result = run()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        return result

    return timed


def _peak(run: Run, device: torch.device) -> int | None:
    """Bytes above what was held before, of one run; ``None`` where the device does not count them."""
    if device.type != "cuda":
        return None
    torch.cuda.synchronize(device)
    torch.cuda.reset_peak_memory_stats(device)
    before = torch.cuda.memory_allocated(device)
    run()
    return torch.cuda.max_memory_allocated(device) - before


def _free(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.empty_cache()


def _times(rows: Sequence[Row]) -> str:
    measured = [row for row in rows if row["part"] == "stages" and "seconds" in row]
    if not measured:
        return ""
    peers = list(dict.fromkeys(name for row in measured for name in row["seconds"] if name != OURS))
    order = list(STAGES)
    lines = []
    for row in sorted(measured, key=lambda row: (order.index(row["case"]), row["points"])):
        seconds, ours = row["seconds"], median(row["seconds"][OURS])
        times = [
            f"{spread(seconds[name])}, {median(seconds[name]) / ours:.1f} x" if name in seconds else ""
            for name in peers
        ]
        each = f"{1e9 * ours / row['points']:,.0f} ns"
        lines.append([row["case"], f"{row['points']:,}", spread(seconds[OURS]), each, in_bytes(row["bytes"]), *times])
    return markdown_table(["stage", "points", OURS, "a point", "peak memory", *peers], lines)


def _pairs_a_second(rows: Sequence[Row]) -> str:
    measured = [row for row in rows if row["part"] == "batches" and "seconds" in row]
    if not measured:
        return ""
    lines = []
    for row in sorted(measured, key=lambda row: (_EFFORTS.index(row["case"]), row["pairs"])):
        seconds = row["seconds"][OURS]
        rate = f"{row['pairs'] / median(seconds):,.1f}"
        lines.append([row["case"], f"{row['pairs']:,}", spread(seconds), rate, in_bytes(row["bytes"])])
    return markdown_table(["effort", "pairs in one call", "seconds", "pairs a second", "peak memory"], lines)


def _document(rows: list[Row], pictures: Sequence[Picture], machine: str) -> str:
    return "\n\n".join(["# Speed on a device", markdown(rows), machine]) + "\n"
