"""KISS-Matcher: Faster-PFH, pruning by a graph of consistent matches, and its own solver.

Lim et al., KISS-Matcher: Fast and Robust Point Cloud Registration Revisited, ICRA 2025, arXiv:2409.15615.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchreg.benchmark.peers.method import Answer, Method, PeerMatches, Task, no_pose, with_origins
from torchreg.types import Correspondences

_LEAST = 50
"""Points; on a dozen, none of which it can describe, it ends the whole process."""


def kiss_register(task: Task) -> Answer:
    """The whole method with its defaults at this voxel size; the clouds are means over voxels already."""
    import kiss_matcher

    if min(len(task.source.points), len(task.target.points)) < _LEAST:
        return no_pose()
    config = kiss_matcher.KISSMatcherConfig(voxel_size=task.voxel, use_voxel_sampling=False)
    matcher = kiss_matcher.KISSMatcher(config)
    solution = matcher.estimate(_points(task.source.points), _points(task.target.points))
    matches = _matches(matcher, task)
    if not solution.valid:
        return no_pose(matches)
    return Answer(T_target_source=with_origins(*_pose(solution), task), success=True, matches=matches)


def _points(points: Tensor) -> list[Any]:
    return list(points.detach().cpu().numpy().astype(np.float32))


def _pose(solution: Any) -> tuple[Tensor, Tensor]:  # noqa: ANN401
    rotation, translation = (
        torch.from_numpy(np.array(part)).double() for part in (solution.rotation, solution.translation)
    )
    return rotation, translation.reshape(3)


def _matches(matcher: Any, task: Task) -> PeerMatches:  # noqa: ANN401
    """Its matches before it prunes them; as it does not sample, their rows are those of the clouds."""
    pairs = torch.tensor(matcher.get_initial_correspondences(), dtype=torch.int64).reshape(-1, 2)
    rows = pairs.t().contiguous()
    matches = Correspondences(rows[0], rows[1], torch.tensor([0, len(pairs)]), torch.zeros(len(pairs)))
    return PeerMatches(task.source, task.target, matches)


METHODS = (
    Method(
        name="kiss-matcher",
        title="KISS-Matcher",
        statement="Its own features, matches and solver with its defaults at this voxel size; no hypotheses.",
        run=kiss_register,
        module="kiss_matcher",
        package="kiss-matcher",
    ),
)
