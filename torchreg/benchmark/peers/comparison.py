"""Methods over pairs of known truth: the study, its rows, and what all its documents say."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell, Picture, Study
from torchreg.benchmark.core.tables import Table
from torchreg.benchmark.peers.judge import judged
from torchreg.benchmark.peers.method import Method, Task
from torchreg.benchmark.peers.registry import NOT_HERE, chosen_methods
from torchreg.errors import expect
from torchreg.preprocess import voxel_downsample
from torchreg.types import Clouds


@dataclass(frozen=True, eq=False, kw_only=True)
class TruePair:
    """One pair to measure.

    Attributes:
        name: different for every pair.
        facts: what its rows say of it besides, ``scene`` among it.
        read: reads both clouds, not yet downsampled.
        voxel: meters, the voxels that they are averaged over.
        near: meters; a match is an inlier, and a source point overlaps, where the truth brings it nearer.
        T_true: (4, 4) float64, meters, origins included.
        information: (6, 6) of the true matches, where it is known.
    """

    name: str
    facts: dict[str, Any]
    read: Callable[[], tuple[Clouds, Clouds]]
    voxel: float
    near: float
    T_true: Tensor
    information: Tensor | None = None


class MethodComparison(NamedTuple):
    """The methods of a study, and its rows.

    Attributes:
        rows: one per pair and method.
        methods: those asked for, in order.
        gaps: why some of them could not run, by name.
        seed: of the intervals.
    """

    rows: Sequence[Row]
    methods: Sequence[Method]
    gaps: Mapping[str, str]
    seed: int = 0

    def of(self, method: Method) -> list[Row]:
        """The rows of one method."""
        return [row for row in self.rows if row["method"] == method.name]

    def empty(self, method: Method, width: int) -> list[str]:
        """The cells of a method without rows."""
        return [method.title, "not installed" if method.name in self.gaps else "not run", *["-"] * (width - 1)]


def comparison_study(
    name: str,
    pairs: Sequence[TruePair],
    methods: Sequence[str] | None,
    settings: Mapping[str, Any],
    *,
    title: str,
    caption: Callable[[MethodComparison], str],
    tables: Callable[[MethodComparison], list[Table]],
    csv: Callable[[MethodComparison], str],
    shown: int,
    seed: int,
    device: str,
    quick: bool,
) -> Study:
    """The study of methods over pairs.

    Args:
        name: of the files, NAME.csv among them.
        pairs: what is registered.
        methods: names; ``None`` takes all.
        settings: what every row depends on beside the seed and the device.
        title: of the document.
        caption: what stands above its tables.
        tables: all of them.
        csv: the numbers in them.
        shown: how many tables a terminal shows.
        seed: of every random draw and of the intervals.
        device: where torchreg computes.
        quick: slow methods run only where they are named.

    Raises:
        ValueError: a name that no method has.
    """
    chosen = chosen_methods(methods, quick=quick)
    gaps = {method.name: why for method in chosen if (why := method.gap())}
    comparison = MethodComparison((), chosen, gaps, seed)
    measure = _measurement(pairs, seed, device)

    def of(rows: list[Row]) -> MethodComparison:
        return comparison._replace(rows=rows)

    def document(rows: list[Row], _: Sequence[Picture], machine: str) -> str:
        parts = [f"# {title}", caption(of(rows)), *(table.section for table in tables(of(rows)))]
        return "\n\n".join([*parts, *_methods_and_gaps(comparison), machine]) + "\n"

    return Study(
        name=name,
        cells=[
            Cell(
                f"{pair.name}/{method.name}",
                f"{pair.name}, {method.title}",
                None if method.name in gaps else partial(measure, number, method),
            )
            for number, pair in enumerate(pairs)
            for method in chosen
        ],
        settings={**settings, "seed": seed, "device": device},
        run={"methods": [method.name for method in chosen]},
        document=document,
        content=lambda rows: {"gaps": gaps, "rows": rows},
        csv=lambda rows: {f"{name}.csv": csv(of(rows))},
        shown=lambda rows: tables(of(rows))[:shown],
        remarks=[f"{method.title} is left out: {gaps[method.name]}" for method in chosen if method.name in gaps],
        device=device,
    )


def chosen_scenes(scenes: Sequence[str] | None, known: Sequence[str]) -> Sequence[str]:
    """The scenes to measure out of the known ones; ``None`` takes all.

    Raises:
        ValueError: none, or an unknown one.
    """
    if scenes is None:
        return known
    expect(len(scenes) > 0, "scenes", "at least one", scenes)
    for scene in scenes:
        expect(scene in known, "scenes", "scenes out of " + ", ".join(dict.fromkeys(known)), scene)
    return scenes


def _measurement(pairs: Sequence[TruePair], seed: int, device: str) -> Callable[[int, Method], Row]:
    """Measures a method on the pair of a number; the clouds of one pair are kept until the next."""
    warm: set[str] = set()

    @lru_cache(maxsize=1)
    def task_of(number: int) -> Task:
        pair = pairs[number]
        source, target = (voxel_downsample(cloud, pair.voxel) for cloud in pair.read())
        return Task(source=source, target=target, voxel=pair.voxel, seed=seed, device=device)

    def measure(number: int, method: Method) -> Row:
        pair, task = pairs[number], task_of(number)
        if method.name not in warm:
            judged(method, _few_points(task), torch.eye(4, dtype=torch.float64), 4 * pair.near)
            warm.add(method.name)
        return {
            "pair": pair.name,
            **pair.facts,
            "voxel_m": pair.voxel,
            "points": [len(task.source.points), len(task.target.points)],
            "method": method.name,
            "version": method.version(),
            **judged(method, task, pair.T_true, pair.near, pair.information),
        }

    return measure


def _few_points(task: Task) -> Task:
    """The same pair at four times the voxel, for a warm-up: what only a first call takes is not counted."""
    voxel = 4 * task.voxel
    source, target = (voxel_downsample(cloud, voxel) for cloud in (task.source, task.target))
    return replace(task, source=source, target=target, voxel=voxel)


def _methods_and_gaps(comparison: MethodComparison) -> list[str]:
    """Sections with a line for every method, and one for each that could not run or cannot be had."""
    methods, gaps = comparison.methods, comparison.gaps
    statements = [f"- {method.title} (`{method.name}`): {method.statement}" for method in methods]
    missing = [f"- {method.title}: {gaps[method.name]}" for method in methods if method.name in gaps]
    missing += [f"- {name}: {why}" for name, why in NOT_HERE.items()]
    return ["## How each was run", "\n".join(statements), "## What is missing", "\n".join(missing)]
