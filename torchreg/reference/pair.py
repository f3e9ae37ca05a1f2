"""One pair through the pipeline by Open3D."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.open3d_loader import load_open3d
from torchreg.reference.legacy import feature, point_cloud, rows
from torchreg.reference.stages import estimate_normals, fpfh, voxel_downsample
from torchreg.registration.describe import color_of_pairs, describe, fused, oriented
from torchreg.registration.stopwatch import Stopwatch
from torchreg.solvers.batch import too_few_matches
from torchreg.types import Clouds, Failure, Features, RegistrationOptions

FEATURES = ("fpfh", "fused")
MUTUAL_SHARE = 0.1
"""Where fewer of the source points than this have a mutual match, Open3D takes all one-way matches."""


@dataclass(eq=False)
class Found:
    """One pair's share of a result.

    Attributes:
        source: the cloud that the matches' rows count, downsampled.
        target: likewise.
        failure: why the pair was not registered, ``None`` where it was.
        T: (4, 4) float64, T_target_source, origins included.
        matches: (M, 2) int64, rows of the pair's own clouds after downsampling.
        score: (M,) float64, distances in feature space.
        inliers: (M,) bool.
        fitness, inlier_rmse: as Open3D returns them.
        notes: what a user should know.
    """

    source: Clouds
    target: Clouds
    failure: Failure | None = None
    T: Tensor = field(default_factory=lambda: torch.eye(4, dtype=torch.float64))
    matches: Tensor = field(default_factory=lambda: torch.zeros(0, 2, dtype=torch.int64))
    score: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.float64))
    inliers: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.bool))
    fitness: float = 0.0
    inlier_rmse: float = 0.0
    notes: tuple[str, ...] = ()


def register_pair(
    source: Clouds, target: Clouds, options: RegistrationOptions, features: str, watch: Stopwatch
) -> Found:
    """Register one cloud to another with one of ``FEATURES``; the watch gets a lap per stage."""
    if options.voxel_size is not None:
        source, target = (voxel_downsample(cloud, options.voxel_size) for cloud in (source, target))
    watch.lap("downsample")
    if features == "fused":
        left, right = _fused(source, target, options, watch)
    else:
        radius, most = options.normal_radius, options.normal_max_neighbors
        source, target = (estimate_normals(cloud, radius, most) for cloud in (source, target))
        watch.lap("neighbors and normals")
        radius, most = options.feature_radius, options.feature_max_neighbors
        left, right = (fpfh(cloud, radius, most) for cloud in (source, target))
        watch.lap("descriptors")
    found = Found(source, target)
    found.matches, found.notes = _match(left, right, everything=features == "fpfh")
    difference = left.values[found.matches[:, 0]].double() - right.values[found.matches[:, 1]].double()
    found.score = difference.norm(dim=1)
    watch.lap("matching")
    _ransac(found, source, target, options)
    watch.lap("hypotheses")
    return found


def _fused(source: Clouds, target: Clouds, options: RegistrationOptions, watch: Stopwatch) -> tuple[Features, Features]:
    """What ``torchreg.register`` matches."""
    source, source_near = oriented(source, [options])
    target, target_near = oriented(target, [options])
    watch.lap("neighbors and normals")
    source_color, target_color = color_of_pairs(source, target, [options])
    color = options.color if source_color is not None else ()
    left = describe(source, source_near, [options], source_color, color)
    right = describe(target, target_near, [options], target_color, color)
    watch.lap("descriptors")
    weights = options.color_weights[: len(color)]
    return fused(left, color, weights, options.root), fused(right, color, weights, options.root)


def _match(source: Features, target: Features, *, everything: bool) -> tuple[Tensor, tuple[str, ...]]:
    """Mutual matches (M, 2), or one-way ones under Open3D's rule; zero rows count only for ``everything``."""
    registration = load_open3d().pipelines.registration
    used = [torch.arange(len(f.valid)) if everything else f.valid.nonzero()[:, 0] for f in (source, target)]
    if min(map(len, used)) == 0:
        return torch.zeros(0, 2, dtype=torch.int64), ()
    left, right = (feature(f.values[kept]) for f, kept in zip((source, target), used, strict=True))
    mutual: Any = registration.correspondences_from_features(left, right, True, 0.0)
    notes: tuple[str, ...] = ()
    if len(mutual) < int(MUTUAL_SHARE * len(used[0])):
        notes = (f"only {len(mutual)} mutual matches for {len(used[0])} source points: Open3D takes one-way matches",)
        mutual = registration.correspondences_from_features(left, right, False)
    local = rows(mutual).reshape(-1, 2)
    return torch.stack([used[0][local[:, 0]], used[1][local[:, 1]]], dim=1), notes


def _ransac(found: Found, source: Clouds, target: Clouds, options: RegistrationOptions) -> None:
    """Fill in what RANSAC finds, or the reason why it found nothing."""
    o3d, told = load_open3d(), options.ransac
    found.inliers = torch.zeros(len(found.matches), dtype=torch.bool)
    if len(found.matches) < told.sample_size:
        found.failure = too_few_matches(len(found.matches), told.sample_size)
        return
    registration = o3d.pipelines.registration
    said = registration.registration_ransac_based_on_correspondence(
        point_cloud(source),
        point_cloud(target),
        o3d.utility.Vector2iVector(found.matches.int().numpy()),
        told.inlier_threshold,
        registration.TransformationEstimationPointToPoint(False),
        told.sample_size,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(told.edge_similarity),
            registration.CorrespondenceCheckerBasedOnDistance(told.inlier_threshold),
        ],
        registration.RANSACConvergenceCriteria(told.hypotheses, told.confidence),
    )
    if said.fitness == 0:
        text = f"no hypothesis left: Open3D kept none of up to {told.hypotheses} samples"
        found.failure = Failure("no hypothesis", text, {"drawn": told.hypotheses})
        return
    found.fitness, found.inlier_rmse = said.fitness, said.inlier_rmse
    T = torch.tensor(said.transformation, dtype=torch.float64)
    R, t = T[:3, :3], T[:3, 3]
    moved = apply_rotation(R, source.points[found.matches[:, 0]].double()) + t
    apart = (moved - target.points[found.matches[:, 1]].double()).norm(dim=1)
    found.inliers = apart < told.inlier_threshold
    found.T = rigid(R, t + target.origin[0] - apply_rotation(R, source.origin[0]))
