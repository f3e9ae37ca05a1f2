"""The input of peers that have no features: normals and FPFH by Open3D, mutual matches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from torchreg.benchmark.peers.method import Answer, PeerMatches, Task, no_pose, with_origins
from torchreg.matching import match_mutual
from torchreg.reference import stages
from torchreg.types import Clouds, Features

HYPOTHESES, CONFIDENCE = 100_000, 0.999
"""Of the solvers on these matches."""

STATEMENT = (
    f"FPFH by Open3D, mutual matches, at most {HYPOTHESES:,} hypotheses, confidence {CONFIDENCE}; takes no seed."
)

MatchedRows = np.ndarray[Any, np.dtype[np.float64]]
"""(M, 6): a source point and its partner in each row."""

_LEAST = 3


def open3d_features(task: Task) -> tuple[Clouds, Clouds, Features, Features]:
    """Both clouds with Open3D's normals, and their FPFH by Open3D."""
    source, target = (stages.estimate_normals(cloud, task.normal_radius, 30) for cloud in (task.source, task.target))
    left, right = (stages.fpfh(cloud, task.feature_radius, 100) for cloud in (source, target))
    return source, target, left, right


def solved_by(solve: Callable[[MatchedRows, float], Any]) -> Callable[[Task], Answer]:
    """A method that solves the mutual matches.

    Args:
        solve: returns the transform for row vectors (4, 4) of matched rows and an inlier threshold in meters, or
            ``None``.
    """

    def run(task: Task) -> Answer:
        source, target, left, right = open3d_features(task)
        correspondences = match_mutual(left, right)
        matches = PeerMatches(source, target, correspondences)
        if len(correspondences.source) < _LEAST:
            return no_pose(matches)
        points = [source.points[correspondences.source], target.points[correspondences.target]]
        rows = torch.cat(points, dim=1).double().numpy()  # (M, 6)
        T = solve(np.ascontiguousarray(rows), task.inlier_threshold)
        if T is None:
            return no_pose(matches)
        T = torch.from_numpy(np.array(T, dtype=np.float64)).t()
        return Answer(T_target_source=with_origins(T[:3, :3], T[:3, 3], task), success=True, matches=matches)

    return run
