"""The answer of a method for a site against the truth, as plain numbers."""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchreg import metrics
from torchreg.benchmark.site.method import SiteAnswer, SiteMethod, SiteTask
from torchreg.benchmark.site.true_site import Readings
from torchreg.geometry.kabsch import kabsch

DEGREES = 5.0
"""A relative pose is right where it is off by less than this, and by less than ``VOXELS``."""

VOXELS = 6.0
"""Edges of a site's voxels."""

_ARM = 20  # voxels, of the frames by which poses are aligned


class PlacedErrors(NamedTuple):
    """How far the poses of one frame are from the truth, once both frames are aligned."""

    meters: Tensor  # (M,) float64
    degrees: Tensor  # (M,) float64


def judged_site(method: SiteMethod, task: SiteTask, truth: Readings) -> dict[str, Any]:
    """Run a method and judge its answer.

    Returns:
        share of the known pairs that are in one group with the right relative pose, wrong and unplaced scans,
        groups (sizes, the largest first), median_mm, largest_mm, median_deg and largest_deg of the scans that are
        placed rightly in the largest group (``None`` where the poses are not known, or fewer than two are right),
        tried (share of all pairs), seconds, and error (the exception or an empty text).
    """
    count = len(task.scans)
    begin = time.perf_counter()
    error = ""
    try:
        answer = method.run(task)
    except Exception as problem:  # a method that fails has placed nothing
        answer, error = _nothing(count), f"{type(problem).__name__}: {problem}"
    seconds = time.perf_counter() - begin
    right, mistaken = verdicts(answer, truth, task.voxel)
    wrong = wrong_scans(mistaken)
    placed = answer.group[answer.group >= 0]
    return {
        "share": right / len(truth.pairs),
        "wrong": len(wrong),
        "unplaced": count - len(placed),
        "groups": sorted(torch.bincount(placed).tolist(), reverse=True) if len(placed) else [],
        **_figures(answer, truth.T_world_scan, wrong, task.voxel),
        "tried": answer.pairs_tried / (count * (count - 1) / 2),
        "seconds": seconds,
        "error": error,
    }


def verdicts(answer: SiteAnswer, truth: Readings, voxel: float) -> tuple[int, list[tuple[int, int]]]:
    """How many of the known pairs have the right relative pose, and which are in one group with a wrong one."""
    right, mistaken = 0, []
    for source, target, T_target_source in truth.pairs:
        if answer.group[source] < 0 or answer.group[source] != answer.group[target]:
            continue
        T = torch.linalg.inv(answer.T_world_scan[target]) @ answer.T_world_scan[source]
        finite = bool(T.isfinite().all())
        if (
            finite
            and float(metrics.rre(T_target_source, T)) < DEGREES
            and float(metrics.rte(T_target_source, T)) < VOXELS * voxel
        ):
            right += 1
        else:
            mistaken.append((source, target))
    return right, mistaken


def wrong_scans(mistaken: list[tuple[int, int]]) -> set[int]:
    """The scans to take out until no wrong pair is left: always the one with most of them."""
    left, out = list(mistaken), set()
    while left:
        ends = [scan for pair in left for scan in pair]
        worst = max(sorted(set(ends)), key=ends.count)
        out.add(worst)
        left = [pair for pair in left if worst not in pair]
    return out


def placed_errors(T_world_scan: Tensor, truth: Tensor, voxel: float) -> PlacedErrors:
    """Errors of poses (M, 4, 4) against true ones, aligned by the rigid motion that fits them best.

    It is the least-squares fit of the scanners' places and of three points on the axes of each, 20 voxels away, so
    that it is well determined however few scanners there are and wherever they stand.
    """
    tips = _ARM * voxel * torch.eye(4, dtype=torch.float64)[:, :3]  # (4, 3): the axes, and the place itself
    tips = torch.cat((tips, torch.ones(4, 1, dtype=torch.float64)), dim=1)  # (4, 4)
    found, true = ((T @ tips.T)[:, :3].mT.reshape(-1, 3) for T in (T_world_scan, truth))  # (4 M, 3)
    T_true_world = kabsch(found, true)
    moved = T_true_world @ T_world_scan
    return PlacedErrors((moved[:, :3, 3] - truth[:, :3, 3]).norm(dim=1), metrics.rre(truth, moved))


def _figures(answer: SiteAnswer, truth: Tensor | None, wrong: set[int], voxel: float) -> dict[str, float | None]:
    names = ("median_mm", "largest_mm", "median_deg", "largest_deg")
    rows = [scan for scan in range(len(answer.group)) if answer.group[scan] == 0 and scan not in wrong]
    if truth is None or len(rows) < 2:
        return dict.fromkeys(names)
    meters, degrees = placed_errors(answer.T_world_scan[rows], truth[rows], voxel)
    values = (1000 * meters.median(), 1000 * meters.max(), degrees.median(), degrees.max())
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _nothing(count: int) -> SiteAnswer:
    T = torch.full((count, 4, 4), math.nan, dtype=torch.float64)
    return SiteAnswer(T_world_scan=T, group=torch.full((count,), -1), pairs_tried=0)
