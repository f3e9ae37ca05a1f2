"""Open3D's RANSAC and its Fast Global Registration, on its own FPFH."""

from __future__ import annotations

from dataclasses import replace

import torch

import torchreg as tr
from torchreg.benchmark.peers.method import Answer, Matched, Method, Task, nothing_found, with_origins
from torchreg.open3d_loader import load_open3d
from torchreg.reference import stages
from torchreg.reference.legacy import feature, point_cloud
from torchreg.registration import options_for
from torchreg.types import Clouds, Features


def described(task: Task) -> tuple[Clouds, Clouds, Features, Features]:
    """Both clouds with Open3D's normals, and their FPFH by Open3D."""
    source, target = (stages.estimate_normals(cloud, task.normal_radius, 30) for cloud in (task.source, task.target))
    left, right = (stages.fpfh(cloud, task.feature_radius, 100) for cloud in (source, target))
    return source, target, left, right


def fast_global_registration(task: Task) -> Answer:
    """Zhou, Park and Koltun, Fast Global Registration, ECCV 2016, doi:10.1007/978-3-319-46475-6_47."""
    o3d = load_open3d()
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(task.seed)
    source, target, left, right = described(task)
    said = registration.registration_fgr_based_on_feature_matching(
        point_cloud(source),
        point_cloud(target),
        feature(left.values),
        feature(right.values),
        registration.FastGlobalRegistrationOption(
            decrease_mu=True, maximum_correspondence_distance=task.inlier_threshold
        ),
    )
    if said.fitness == 0:
        return nothing_found()
    T = torch.tensor(said.transformation, dtype=torch.float64)
    return Answer(T_target_source=with_origins(T[:3, :3], T[:3, 3], task), success=True)


def _ransac(hypotheses: int, confidence: float) -> Method:
    def run(task: Task) -> Answer:
        options = options_for(task.voxel, colored=False)
        told = replace(options.ransac, hypotheses=hypotheses, confidence=confidence)
        result = tr.reference.open3d.register(task.source, task.target, replace(options, ransac=told), seed=task.seed)
        return Answer(
            T_target_source=result.T_target_source[0],
            success=bool(result.success[0]),
            matches=Matched(task.source, task.target, result.correspondences),
        )

    every = confidence == 1
    said = f"{hypotheses:,} hypotheses, all of them" if every else f"at most {hypotheses:,} hypotheses"
    thousands = f"{hypotheses // 1000}k"
    return Method(
        name=f"open3d-{thousands}-all" if every else f"open3d-{thousands}",
        title=f"Open3D RANSAC, {hypotheses:,}" + (", no early end" if every else ""),
        statement=f"FPFH, mutual matches (one-way where they are few), RANSAC of {said}, confidence {confidence:g}.",
        run=run,
        slow=every,
    )


OPEN3D = (
    _ransac(100_000, 0.999),
    _ransac(600_000, 0.999),
    _ransac(600_000, 1.0),
    Method(
        name="open3d-fgr",
        title="Open3D FGR",
        statement="FPFH, Open3D's own matches with its tuple test (1,000 tuples), 64 iterations, mu decreasing to the "
        "inlier threshold; no hypotheses.",
        run=fast_global_registration,
    ),
)
