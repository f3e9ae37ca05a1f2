"""What is timed: every stage and the whole pair, by this library and by Open3D.

Open3D's classic pipeline computes in float64 and searches neighbors anew in every stage; its tensor pipeline computes
in float32. Our stages take given neighborhoods; the search is a row of its own. Open3D has no color histograms, so FPFH
and PCFH together are compared with its FPFH alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch

from torchreg.benchmark.speed.scene import TimedCloud, TimedScene
from torchreg.descriptors.fpfh import Fpfh, fpfh
from torchreg.descriptors.pcfh import Pcfh, pcfh
from torchreg.geometry.numerics.compiled import compiled_kernels
from torchreg.matching import match_mutual
from torchreg.neighborhoods import neighbors
from torchreg.open3d_loader import load_open3d
from torchreg.preprocess import estimate_normals
from torchreg.reference import open3d
from torchreg.reference.legacy import feature, hybrid, point_cloud
from torchreg.registration import PAPER
from torchreg.registration.register import register
from torchreg.solvers.ransac import RansacOptions, ransac
from torchreg.types import Clouds, Correspondences

OURS, COMPILED, CLASSIC, TENSOR = "torchreg", "torchreg, compiled", "Open3D", "Open3D, tensor"
METHODS = (OURS, COMPILED, CLASSIC, TENSOR)

Run = Callable[[], Any]
Subject = Callable[[TimedScene], dict[str, Run]]


def search(scene: TimedScene) -> dict[str, Run]:
    """The hybrid search of FPFH's support."""
    side, radius = scene.source, 5 * scene.source.spacing

    def tensor() -> object:
        core = load_open3d().core
        points = core.Tensor.from_dlpack(side.cloud.points.__dlpack__())
        index = core.nns.NearestNeighborSearch(points, core.int32)
        index.hybrid_index(radius)
        return index.hybrid_search(points, radius, side.max_neighbors)

    return {OURS: lambda: neighbors(side.cloud, radius, side.max_neighbors), TENSOR: tensor}


def normals(scene: TimedScene) -> dict[str, Run]:
    """Normals, 30 nearest within 2 spacings, neighborhoods given."""
    side, radius = scene.source, 2 * scene.source.spacing
    near = side.near.restrict(radius, 30)
    classic, tensor = point_cloud(side.cloud), _tensor_cloud(side, oriented=False)
    return {
        OURS: lambda: estimate_normals(side.cloud, near),
        CLASSIC: lambda: classic.estimate_normals(hybrid(radius, 30)),
        TENSOR: lambda: tensor.estimate_normals(30, radius),
    }


def fpfh_alone(scene: TimedScene) -> dict[str, Run]:
    """FPFH, neighborhoods given."""
    side = scene.source
    return {**_ours(lambda: fpfh(side.oriented, side.near)), **_open3d_fpfh(side)}


def fpfh_and_pcfh(scene: TimedScene) -> dict[str, Run]:
    """FPFH and PCFH, neighborhoods given."""
    side = scene.source
    color = side.near.restrict(2 * side.spacing)

    def both() -> object:
        return fpfh(side.oriented, side.near), pcfh(side.oriented, color)

    return {**_ours(both), **_open3d_fpfh(side)}


def with_search(scene: TimedScene) -> dict[str, Run]:
    """FPFH and PCFH with the neighbor search."""
    side = scene.source

    def both() -> object:
        near = neighbors(side.oriented, 5 * side.spacing, side.max_neighbors)
        return fpfh(side.oriented, near), pcfh(side.oriented, near.restrict(2 * side.spacing))

    return {**_ours(both), **_open3d_fpfh(side)}


def matching(scene: TimedScene) -> dict[str, Run]:
    """Mutual matches of 44 numbers a point."""
    registration = load_open3d().pipelines.registration
    ours = (scene.source.features, scene.target.features)
    theirs = [feature(features.values) for features in ours]
    return {
        OURS: lambda: match_mutual(*ours),
        CLASSIC: lambda: registration.correspondences_from_features(*theirs, mutual_filter=True),
    }


def hypotheses(count: int) -> Subject:
    """So many RANSAC hypotheses over the mutual matches, without an early end."""

    def subject(scene: TimedScene) -> dict[str, Run]:
        threshold = 1.5 * scene.source.spacing
        options = RansacOptions(hypotheses=count, confidence=1.0, inlier_threshold=threshold)
        given = scene.source.cloud, scene.target.cloud, scene.matches
        return {OURS: lambda: ransac(*given, options), CLASSIC: matched_ransac(*given, options)}

    return subject


def matched_ransac(source: Clouds, target: Clouds, matches: Correspondences, options: RansacOptions) -> Run:
    """Open3D's RANSAC over the matches of one pair, its hypotheses, threshold and tests those of the options."""
    o3d = load_open3d()
    registration = o3d.pipelines.registration
    clouds = [point_cloud(source), point_cloud(target)]
    pairs = o3d.utility.Vector2iVector(torch.stack([matches.source, matches.target], dim=1).int().numpy())
    checkers = [
        registration.CorrespondenceCheckerBasedOnEdgeLength(options.edge_similarity),
        registration.CorrespondenceCheckerBasedOnDistance(options.inlier_threshold),
    ]
    return lambda: registration.registration_ransac_based_on_correspondence(
        *clouds,
        pairs,
        options.inlier_threshold,
        registration.TransformationEstimationPointToPoint(False),
        options.sample_size,
        checkers,
        registration.RANSACConvergenceCriteria(options.hypotheses, options.confidence),
    )


def whole(count: int) -> Subject:
    """From points to the transform: so many hypotheses without an early end; Open3D by FPFH alone."""

    def subject(scene: TimedScene) -> dict[str, Run]:
        spacing = scene.source.spacing
        options = replace(
            PAPER,
            normal_radius=2 * spacing,
            descriptors=(Fpfh(radius=5 * spacing), Pcfh(radius=2 * spacing)),
            solver=RansacOptions(hypotheses=count, confidence=1.0, inlier_threshold=1.5 * spacing),
        )
        alone = options.without_color()
        clouds = scene.source.cloud, scene.target.cloud
        return {**_ours(lambda: register(*clouds, options)), CLASSIC: lambda: open3d.register(*clouds, alone)}

    return subject


def _ours(run: Run) -> dict[str, Run]:
    def compiled() -> object:
        with compiled_kernels():
            return run()

    return {OURS: run, COMPILED: compiled}


def _open3d_fpfh(side: TimedCloud) -> dict[str, Run]:
    o3d = load_open3d()
    radius, most = 5 * side.spacing, side.max_neighbors
    classic, tensor = point_cloud(side.oriented), _tensor_cloud(side, oriented=True)
    return {
        CLASSIC: lambda: o3d.pipelines.registration.compute_fpfh_feature(classic, hybrid(radius, most)),
        TENSOR: lambda: o3d.t.pipelines.registration.compute_fpfh_feature(tensor, most, radius),
    }


def _tensor_cloud(side: TimedCloud, *, oriented: bool) -> Any:  # noqa: ANN401
    o3d = load_open3d()
    cloud = o3d.t.geometry.PointCloud()
    cloud.point.positions = o3d.core.Tensor(side.cloud.points.contiguous().numpy())
    if oriented and side.oriented.normals is not None:
        cloud.point.normals = o3d.core.Tensor(side.oriented.normals.contiguous().numpy())
    return cloud
