"""Open3D's RANSAC on its own FPFH."""

from __future__ import annotations

from dataclasses import replace

import torchreg as tr
from torchreg.benchmark.peers.method import Answer, Method, PeerMatches, Task
from torchreg.registration import options_for


def _ransac(hypotheses: int, confidence: float) -> Method:
    def run(task: Task) -> Answer:
        solver = tr.RansacOptions(hypotheses=hypotheses, confidence=confidence, inlier_threshold=task.inlier_threshold)
        options = replace(options_for(task.voxel, colored=False), solver=solver)
        result = tr.reference.open3d.register(task.source, task.target, options, seed=task.seed)
        return Answer(
            T_target_source=result.T_target_source[0],
            success=bool(result.success[0]),
            matches=PeerMatches(task.source, task.target, result.correspondences),
        )

    every = confidence == 1
    drawn = f"{hypotheses:,} hypotheses, all of them" if every else f"at most {hypotheses:,} hypotheses"
    thousands = f"{hypotheses // 1000}k"
    return Method(
        name=f"open3d-{thousands}-all" if every else f"open3d-{thousands}",
        title=f"Open3D RANSAC, {hypotheses:,}" + (", no early end" if every else ""),
        statement=f"FPFH, mutual matches (one-way where they are few), RANSAC of {drawn}, confidence {confidence:g}.",
        run=run,
        slow=every,
    )


METHODS = (
    _ransac(100_000, 0.999),
    _ransac(600_000, 0.999),
    _ransac(600_000, 1.0),
)
