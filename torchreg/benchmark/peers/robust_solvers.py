"""Robust solvers from other libraries, on the mutual matches of Open3D's FPFH.

Graph-Cut RANSAC: Barath and Matas, CVPR 2018, doi:10.1109/CVPR.2018.00704. MAGSAC++: Barath et al., CVPR 2020,
doi:10.1109/CVPR42600.2020.00138. Both hand out the transform for row vectors.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchreg.benchmark.peers.method import Answer, Matched, Method, Task, nothing_found, with_origins
from torchreg.benchmark.peers.open3d_methods import described
from torchreg.matching import match_mutual

HYPOTHESES, CONFIDENCE = 100_000, 0.999
_LEAST = 3

Pairs = np.ndarray[Any, np.dtype[np.float64]]
"""(M, 6): a source point and its partner in each row."""

Solver = Callable[[Pairs, float], Any]


def graph_cut_ransac(pairs: Pairs, threshold: float) -> Any:  # noqa: ANN401
    """The transform for row vectors (4, 4), or ``None``."""
    import pygcransac

    # space partitioning, which its default is, takes neighborhood 0 alone
    found, _ = pygcransac.findRigidTransform(
        pairs, np.zeros(0), threshold, conf=CONFIDENCE, max_iters=HYPOTHESES, neighborhood=0, sampler=0
    )
    return found


def magsac(pairs: Pairs, threshold: float) -> Any:  # noqa: ANN401
    """The transform for row vectors (4, 4), or ``None``."""
    import pymagsac

    found, _ = pymagsac.findRigidTransformation(
        pairs, np.zeros(0), sampler=0, sigma_th=threshold, conf=CONFIDENCE, max_iters=HYPOTHESES
    )
    return found


def _with(solver: Solver) -> Callable[[Task], Answer]:
    def run(task: Task) -> Answer:
        source, target, left, right = described(task)
        found = match_mutual(left, right)
        matches = Matched(source, target, found)
        if len(found.source) < _LEAST:
            return nothing_found(matches)
        pairs = torch.cat([source.points[found.source], target.points[found.target]], dim=1)  # (M, 6)
        T = solver(np.ascontiguousarray(pairs.double().numpy()), task.inlier_threshold)
        if T is None:
            return nothing_found(matches)
        return Answer(T_target_source=with_origins(*_pose(T), task), success=True, matches=matches)

    return run


def _pose(T: Any) -> tuple[Tensor, Tensor]:  # noqa: ANN401
    columns = torch.from_numpy(np.array(T, dtype=np.float64)).t()
    return columns[:3, :3], columns[:3, 3]


_HOW = f"FPFH by Open3D, mutual matches, at most {HYPOTHESES:,} hypotheses, confidence {CONFIDENCE}; takes no seed."

SOLVERS = (
    Method(
        name="gc-ransac",
        title="Graph-Cut RANSAC",
        statement=_HOW,
        run=_with(graph_cut_ransac),
        module="pygcransac",
        package="pygcransac",
    ),
    Method(
        name="magsac",
        title="MAGSAC++",
        statement=_HOW,
        run=_with(magsac),
        module="pymagsac",
        package="pymagsac",
    ),
)
