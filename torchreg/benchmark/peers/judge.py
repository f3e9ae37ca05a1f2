"""The answer of a method for a pair against the truth, as plain numbers."""

from __future__ import annotations

import math
import time
from typing import Any

from torch import Tensor

from torchreg import metrics
from torchreg.benchmark.peers.method import Answer, Method, Task, no_pose


def judged(
    method: Method, task: Task, T_true: Tensor, near: float, information: Tensor | None = None
) -> dict[str, Any]:
    """Run a method and judge its answer.

    Args:
        method: which one.
        task: the pair.
        T_true: (4, 4) float64, meters, origins included.
        near: meters; a match is an inlier, and a source point overlaps, where it is nearer to its partner under the
            truth.
        information: (6, 6) of the true matches, where it is known.

    Returns:
        success (as the method calls it), rre_deg, rte_m, rmse_m over the true matches (``None`` where the clouds do not
        overlap), information_rmse_m (the same by the information matrix, or ``None``), inlier_ratio and matches
        (``None`` where the method does not return matches), seconds from the clouds to the pose, error (the exception
        or an empty text), and T (4 x 4).
    """
    begin = time.perf_counter()
    error = ""
    try:
        answer = method.run(task)
    except Exception as problem:  # a method that fails has not found the pair
        answer, error = no_pose(), f"{type(problem).__name__}: {problem}"
    seconds = time.perf_counter() - begin
    if not bool(answer.T_target_source.isfinite().all()):
        answer, error = no_pose(answer.matches), "a transform that is not finite"
    T = answer.T_target_source
    by_points = metrics.rmse_of_true_matches(task.source, task.target, T_true[None], T[None], near)
    by_information = None if information is None else metrics.rmse_by_information(T_true, T, information)
    return {
        "success": answer.success,
        "rre_deg": float(metrics.rre(T_true, T)),
        "rte_m": float(metrics.rte(T_true, T)),
        "rmse_m": _finite(by_points),
        "information_rmse_m": _finite(by_information),
        "inlier_ratio": _inlier_ratio(answer, T_true, near),
        "matches": None if answer.matches is None else len(answer.matches.correspondences.source),
        "seconds": seconds,
        "error": error,
        "T": T.tolist(),
    }


def _finite(value: Tensor | None) -> float | None:
    return None if value is None or not math.isfinite(float(value)) else float(value)


def _inlier_ratio(answer: Answer, T_true: Tensor, near: float) -> float | None:
    if answer.matches is None:
        return None
    source, target, matches = answer.matches
    return float(metrics.inlier_ratio(source, target, matches, T_true[None], near))
