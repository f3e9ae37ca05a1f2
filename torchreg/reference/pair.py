"""One pair through the pipeline by Open3D."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.open3d_loader import load_open3d
from torchreg.reference import stages
from torchreg.reference.legacy import feature, point_cloud, rows
from torchreg.registration.describe import describe_thin, description_of
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.recipes import fused, recipes_of
from torchreg.registration.stopwatch import stage
from torchreg.solvers import RansacOptions
from torchreg.solvers.batch import too_few_matches
from torchreg.types import Clouds, Failure, Features

FEATURES = ("fpfh", "fused")
MUTUAL_SHARE = 0.1
"""Where fewer of the source points than this have a mutual match, Open3D takes all one-way matches."""


@dataclass(eq=False)
class PairOutcome:
    """One pair's share of a result."""

    source: Clouds  # the cloud that the matches' rows count, downsampled
    target: Clouds  # likewise
    failure: Failure | None = None  # why the pair was not registered, ``None`` where it was
    # (4, 4) float64, T_target_source, origins included
    T: Tensor = field(default_factory=lambda: torch.eye(4, dtype=torch.float64))
    # (M, 2) int64, rows of the pair's own clouds after downsampling
    matches: Tensor = field(default_factory=lambda: torch.zeros(0, 2, dtype=torch.int64))
    # (M,) float64, distances in feature space
    score: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.float64))
    inliers: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.bool))  # (M,) bool
    fitness: float = 0.0  # as Open3D returns it
    inlier_rmse: float = 0.0  # as Open3D returns it
    notes: tuple[str, ...] = ()  # what a user should know


def register_pair(source: Clouds, target: Clouds, options: RegistrationOptions, features: str) -> PairOutcome:
    """Register one cloud to another with one of ``FEATURES``."""
    source, target = _downsampled(source, target, options)
    describe = _by_torchreg if features == "fused" else _by_open3d
    left, right = describe(source, target, options)
    outcome = PairOutcome(source, target)
    _match(outcome, left, right, everything=features == "fpfh")
    _ransac(outcome, options)
    return outcome


def fpfh_of(options: RegistrationOptions) -> Descriptor:
    """The record whose support Open3D's FPFH takes: that of FPFH, or the first one where FPFH is not among them."""
    return next((record for record in options.descriptors if isinstance(record, Fpfh)), options.descriptors[0])


@stage("downsample")
def _downsampled(source: Clouds, target: Clouds, options: RegistrationOptions) -> tuple[Clouds, Clouds]:
    if options.voxel_size is None:
        return source, target
    return stages.voxel_downsample(source, options.voxel_size), stages.voxel_downsample(target, options.voxel_size)


def _by_torchreg(source: Clouds, target: Clouds, options: RegistrationOptions) -> tuple[Features, Features]:
    """What ``torchreg.register`` matches."""
    colored = source.colors is not None and target.colors is not None
    bare = [replace(cloud, normals=None, colors=cloud.colors if colored else None) for cloud in (source, target)]
    description = description_of(options, colored=colored)
    sides = describe_thin(Clouds.pack(bare), [description, description], 1 << 28).unpack()
    recipe = recipes_of(options, colored=colored)[0]
    return fused(sides[0], recipe, options), fused(sides[1], recipe, options)


def _by_open3d(source: Clouds, target: Clouds, options: RegistrationOptions) -> tuple[Features, Features]:
    """Open3D's FPFH."""
    return _fpfh(_with_normals(source, options), options), _fpfh(_with_normals(target, options), options)


@stage("neighbors and normals")
def _with_normals(cloud: Clouds, options: RegistrationOptions) -> Clouds:
    return stages.estimate_normals(cloud, options.normal_radius, options.normal_max_neighbors)


@stage("descriptors")
def _fpfh(cloud: Clouds, options: RegistrationOptions) -> Features:
    record = fpfh_of(options)
    return stages.fpfh(cloud, record.radius, record.max_neighbors)


@stage("matching")
def _match(outcome: PairOutcome, left: Features, right: Features, *, everything: bool) -> None:
    """Fill in mutual matches, or one-way ones under Open3D's rule; zero rows count only for ``everything``."""
    registration = load_open3d().pipelines.registration
    used = [torch.arange(len(f.valid)) if everything else f.valid.nonzero()[:, 0] for f in (left, right)]
    if min(map(len, used)) == 0:
        return
    one, other = (feature(f.values[kept]) for f, kept in zip((left, right), used, strict=True))
    mutual: Any = registration.correspondences_from_features(one, other, True, 0.0)
    if len(mutual) < int(MUTUAL_SHARE * len(used[0])):
        note = f"only {len(mutual)} mutual matches for {len(used[0])} source points: Open3D takes one-way matches"
        outcome.notes = (note,)
        mutual = registration.correspondences_from_features(one, other, False)
    local = rows(mutual).reshape(-1, 2)
    matches = torch.stack([used[0][local[:, 0]], used[1][local[:, 1]]], dim=1)
    difference = left.values[matches[:, 0]].double() - right.values[matches[:, 1]].double()
    outcome.matches, outcome.score = matches, difference.norm(dim=1)


@stage("hypotheses")
def _ransac(outcome: PairOutcome, options: RegistrationOptions) -> None:
    """Fill in the pose of RANSAC, or why there is none."""
    o3d, solver = load_open3d(), options.solver
    ransac = solver if isinstance(solver, RansacOptions) else RansacOptions(inlier_threshold=solver.inlier_threshold)
    source, target = outcome.source, outcome.target
    outcome.inliers = torch.zeros(len(outcome.matches), dtype=torch.bool)
    if len(outcome.matches) < ransac.sample_size:
        outcome.failure = too_few_matches(len(outcome.matches), ransac.sample_size)
        return
    registration = o3d.pipelines.registration
    winner = registration.registration_ransac_based_on_correspondence(
        point_cloud(source),
        point_cloud(target),
        o3d.utility.Vector2iVector(outcome.matches.int().numpy()),
        ransac.inlier_threshold,
        registration.TransformationEstimationPointToPoint(False),
        ransac.sample_size,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(ransac.edge_similarity),
            registration.CorrespondenceCheckerBasedOnDistance(ransac.inlier_threshold),
        ],
        registration.RANSACConvergenceCriteria(ransac.hypotheses, ransac.confidence),
    )
    if winner.fitness == 0:
        text = f"no hypothesis left: Open3D kept none of up to {ransac.hypotheses} samples"
        outcome.failure = Failure("no hypothesis", text, {"drawn": ransac.hypotheses})
        return
    outcome.fitness, outcome.inlier_rmse = winner.fitness, winner.inlier_rmse
    T = torch.tensor(winner.transformation, dtype=torch.float64)
    R, t = T[:3, :3], T[:3, 3]
    moved = apply_rotation(R, source.points[outcome.matches[:, 0]].double()) + t
    apart = (moved - target.points[outcome.matches[:, 1]].double()).norm(dim=1)
    outcome.inliers = apart < ransac.inlier_threshold
    outcome.T = rigid(R, t + target.origin[0] - apply_rotation(R, source.origin[0]))
