"""Methods compared on pairs of known truth: the study, its rows, and the sections that all its documents have."""

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

_QUICK_SCENES = 2


@dataclass(frozen=True, eq=False, kw_only=True)
class TruePair:
    """One pair to measure."""

    name: str  # different for every pair
    facts: dict[str, Any]  # further values of its rows, ``scene`` among them
    read: Callable[[], tuple[Clouds, Clouds]]  # reads both clouds, not yet downsampled
    voxel: float  # meters, the voxels that they are averaged over
    near: float  # meters; nearer to its partner under the truth, a match is an inlier and a source point overlaps
    T_true: Tensor  # (4, 4) float64, meters, origins included
    information: Tensor | None = None  # (6, 6) of the true matches, where it is known


class MethodComparison(NamedTuple):
    """The methods of a study, and its rows."""

    rows: Sequence[Row]  # one per pair and method
    methods: Sequence[Method]  # those asked for, in order
    gaps: Mapping[str, str]  # why some of them could not run, by name
    seed: int = 0  # of the intervals

    def of(self, method: Method) -> list[Row]:
        """The rows of one method."""
        return [row for row in self.rows if row["method"] == method.name]

    def empty(self, method: Method, width: int) -> list[str]:
        """The cells of a method without rows."""
        return [method.title, "not installed" if method.name in self.gaps else "not run", *["-"] * (width - 1)]


@dataclass(frozen=True, kw_only=True)
class ComparisonOptions:
    """Which methods are compared on which pairs, and how they run."""

    methods: Sequence[str] | None = None  # their names; ``None`` takes all
    more: Sequence[Method] = ()  # further ones, before these
    scenes: Sequence[str] | None = None  # whose pairs are taken; ``None`` takes all
    quick: bool = False  # one pair of each of the first two scenes alone; slow methods only where they are named
    device: str = "cpu"  # where torchreg computes
    seed: int = 0  # of every random draw and of the intervals


EVERYTHING = ComparisonOptions()
"""Every method on every pair."""


def comparison_study(
    name: str,
    listed: Sequence[TruePair],
    options: ComparisonOptions,
    settings: Mapping[str, Any],
    *,
    title: str,
    caption: Callable[[MethodComparison], str],
    tables: Callable[[MethodComparison], list[Table]],
    csv: Callable[[MethodComparison], str],
    shown: int,
    rank: Callable[[TruePair], float],
) -> Study:
    """The study of methods over pairs.

    Args:
        name: of the files, NAME.csv among them.
        listed: the pairs to choose from.
        options: which of them, and which methods.
        settings: what every row depends on beside the seed and the device.
        title: of the document.
        caption: the text above its tables.
        tables: all of them.
        csv: the numbers in them.
        shown: how many tables a terminal shows.
        rank: a quick run takes the first pair of the highest rank of each of two scenes.

    Raises:
        ValueError: a name that no method or no scene has.
    """
    chosen = (*options.more, *chosen_methods(options.methods, quick=options.quick))
    pairs = _chosen_pairs(listed, options, rank)
    gaps = {method.name: why for method in chosen if (why := method.gap())}
    comparison = MethodComparison((), chosen, gaps, options.seed)
    measure = _measurement(pairs, options.seed, options.device)

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
        settings={**settings, "seed": options.seed, "device": options.device},
        run={"methods": [method.name for method in chosen]},
        document=document,
        content=lambda rows: {"gaps": gaps, "rows": rows},
        csv=lambda rows: {f"{name}.csv": csv(of(rows))},
        shown=lambda rows: tables(of(rows))[:shown],
        remarks=[f"{method.title} is left out: {gaps[method.name]}" for method in chosen if method.name in gaps],
        device=options.device,
    )


def _chosen_pairs(
    listed: Sequence[TruePair], options: ComparisonOptions, rank: Callable[[TruePair], float]
) -> list[TruePair]:
    by_scene: dict[str, list[TruePair]] = {}
    for pair in listed:
        by_scene.setdefault(pair.facts["scene"], []).append(pair)
    scenes = tuple(by_scene) if options.scenes is None else options.scenes
    expect(len(scenes) > 0, "scenes", "at least one", scenes)
    for scene in scenes:
        expect(scene in by_scene, "scenes", "scenes out of " + ", ".join(by_scene), scene)
    if options.quick:
        best = [max(pairs, key=rank) for scene, pairs in by_scene.items() if scene in scenes]
        return best[:_QUICK_SCENES]
    return [pair for pair in listed if pair.facts["scene"] in scenes]


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
