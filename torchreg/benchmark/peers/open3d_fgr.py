"""Open3D's Fast Global Registration on its own FPFH."""

from __future__ import annotations

import torch

from torchreg.benchmark.peers.method import Answer, Method, Task, no_pose, with_origins
from torchreg.benchmark.peers.open3d_features import open3d_features
from torchreg.open3d_loader import load_open3d
from torchreg.reference.legacy import feature, point_cloud
from torchreg.seeds import open3d_seed


def fast_global_registration(task: Task) -> Answer:
    """Zhou, Park and Koltun, Fast Global Registration, ECCV 2016, doi:10.1007/978-3-319-46475-6_47."""
    o3d = load_open3d()
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(open3d_seed(task.seed))
    source, target, left, right = open3d_features(task)
    solution = registration.registration_fgr_based_on_feature_matching(
        point_cloud(source),
        point_cloud(target),
        feature(left.values),
        feature(right.values),
        registration.FastGlobalRegistrationOption(
            decrease_mu=True, maximum_correspondence_distance=task.inlier_threshold
        ),
    )
    if solution.fitness == 0:
        return no_pose()
    T = torch.tensor(solution.transformation, dtype=torch.float64)
    return Answer(T_target_source=with_origins(T[:3, :3], T[:3, 3], task), success=True)


METHODS = (
    Method(
        name="open3d-fgr",
        title="Open3D FGR",
        statement="FPFH, Open3D's own matches with its tuple test (1,000 tuples), 64 iterations, mu decreasing to the "
        "inlier threshold; no hypotheses.",
        run=fast_global_registration,
    ),
)
