"""Methods over pairs, row by row, each kept as soon as it is there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchreg.benchmark.judge import judged
from torchreg.benchmark.peers import Method, Task
from torchreg.benchmark.rows import Rows
from torchreg.preprocess import voxel_downsample
from torchreg.types import Clouds

Report = Callable[[str], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class Item:
    """One pair to measure.

    Attributes:
        name: different for every pair.
        facts: what its rows say of it besides.
        read: both clouds, not yet thinned.
        voxel: meters, what they are averaged over.
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


def key_of(item: Item, method: Method) -> str:
    """The name of a row."""
    return f"{item.name}/{method.name}"


def measure(
    items: Sequence[Item], methods: Sequence[Method], rows: Rows, *, seed: int, device: str, report: Report
) -> None:
    """Run every method on every pair that has no row yet.

    Args:
        items: the pairs.
        methods: those that can run here.
        rows: what was measured before; rows are added.
        seed: of every random draw.
        device: where a method computes that can compute elsewhere than on the CPU.
        report: is told what is being done, in a few words.
    """
    warm: set[str] = set()
    for number, item in enumerate(items, start=1):
        missing = [method for method in methods if key_of(item, method) not in rows]
        if not missing:
            continue
        source, target = (voxel_downsample(cloud, item.voxel) for cloud in item.read())
        task = Task(source=source, target=target, voxel=item.voxel, seed=seed, device=device)
        for method in missing:
            report(f"pair {number} of {len(items)}, {item.name}: {method.title}")
            if method.name not in warm:
                judged(method, _few_points(task), torch.eye(4, dtype=torch.float64), 4 * item.near)
                warm.add(method.name)
            facts = {
                "key": key_of(item, method),
                "pair": item.name,
                **item.facts,
                "voxel_m": item.voxel,
                "points": [len(source.points), len(target.points)],
                "method": method.name,
                "version": method.version(),
            }
            rows.add({**facts, **judged(method, task, item.T_true, item.near, item.information)})


def _few_points(task: Task) -> Task:
    """The same pair at four times the voxel: what a first call alone takes is not counted."""
    voxel = 4 * task.voxel
    source, target = (voxel_downsample(cloud, voxel) for cloud in (task.source, task.target))
    return replace(task, source=source, target=target, voxel=voxel)
