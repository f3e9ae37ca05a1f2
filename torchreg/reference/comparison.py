"""torchreg and Open3D side by side on one pair, and what the comparison shows as named numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect_in_words, expect_shape, one_of
from torchreg.io.result_json import plain_data
from torchreg.metrics import PoseErrors, pose_errors
from torchreg.reference import open3d
from torchreg.reference.descriptors import DescriptorDifference, descriptor_differences
from torchreg.reference.pair import FEATURES, fpfh_of
from torchreg.registration import derive_options
from torchreg.registration.describe import description_of, downsample, oriented
from torchreg.registration.inspect import refuse
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.register import register
from torchreg.types import Clouds, Correspondences, RegistrationResult

_BEFORE = ("options", "downsample")  # stages that torchreg goes through once, for both
_WARM_UP_POINTS = 500


@dataclass(frozen=True, eq=False, kw_only=True)
class Side:
    """The run of one of the two.

    Attributes:
        T_target_source: (4, 4) float64, meters, origins included.
        success: whether it calls the pair registered.
        reason: why not, or an empty text.
        notes: of its result, for a user.
        matches: how many correspondences it found.
        inliers: how many of them its transform brings within the inlier threshold.
        fitness: of its transform by Open3D's ``evaluate_registration``; ``None`` where it has none.
        inlier_rmse: likewise, meters.
        truth: errors against the true transform, where that is known and the pair was registered.
        seconds: of every stage after downsampling, by name, in order.
    """

    T_target_source: Tensor
    success: bool
    reason: str
    notes: tuple[str, ...]
    matches: int
    inliers: int
    fitness: float | None
    inlier_rmse: float | None
    truth: PoseErrors | None
    seconds: dict[str, float]

    @property
    def total_seconds(self) -> float:
        """The time of these stages."""
        return sum(self.seconds.values())


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """One pair registered by torchreg and by Open3D from the same points, and their FPFH row by row.

    Attributes:
        options: what both were run with, derived numbers included.
        features: what both matched: "fused" or "fpfh".
        points: of source and target, after downsampling.
        descriptors: source and target, in float64 and float32 each; empty where a cloud cannot be described.
        torchreg: its run.
        open3d: its run.
        shared_matches: correspondences that both found.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> options = tr.RegistrationOptions(voxel_size=1.5, solver=tr.RansacOptions(hypotheses=1000))
        >>> comparison = tr.reference.compare(pair.source, pair.target, options)
        >>> comparison.points[0] < len(pair.source.points)
        True
    """

    options: RegistrationOptions
    features: str
    points: tuple[int, int]
    descriptors: tuple[DescriptorDifference, ...]
    torchreg: Side
    open3d: Side
    shared_matches: int

    @property
    def descriptors_agree(self) -> bool:
        """Whether there are descriptors, and all rows without a tie are within their tolerance."""
        return len(self.descriptors) > 0 and all(difference.agree for difference in self.descriptors)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, texts and lists, ready for JSON; numbers that are not finite become ``None``."""
        counts = {"torchreg": self.torchreg.matches, "open3d": self.open3d.matches, "shared": self.shared_matches}
        differences = [{**plain_data(one), "share_off": one.share_off, "agree": one.agree} for one in self.descriptors]
        return {
            "features": self.features,
            "points": {"source": self.points[0], "target": self.points[1]},
            "descriptors_agree": self.descriptors_agree,
            "descriptors": differences,
            "matches": counts,
            "torchreg": _plain_side(self.torchreg),
            "open3d": _plain_side(self.open3d),
            "options": plain_data(self.options),
        }


def _plain_side(side: Side) -> dict[str, Any]:
    """A side for JSON: as in a result's JSON, the pose of a refused pair has a key of its own."""
    likeliest = None if side.success or bool((side.T_target_source == torch.eye(4)).all()) else side.T_target_source
    known = {**plain_data(side), "likeliest_T_target_source": plain_data(likeliest)}
    return known if side.success else {**known, "T_target_source": None}


@entry
def compare(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | None = None,
    *,
    truth: Tensor | None = None,
    seed: int = 0,
    features: str = "fused",
) -> Comparison:
    """Register a pair with torchreg and with Open3D, and compare what every stage gave.

    Like is set beside like: the plain procedure, mutual matches and RANSAC, whatever effort and solver the options
    name. Both start from the points that torchreg downsamples, so that rows are the same places. FPFH are compared
    with the same normals and neighborhoods, in float64 and in float32, whatever is matched.

    Args:
        source: one cloud.
        target: one cloud.
        options: in meters; ``None`` derives them as ``register`` does.
        truth: (4, 4) the true T_target_source, meters, origins included, where it is known.
        seed: of both.
        features: "fused", torchreg's, matched by both, or "fpfh", each its own and no color.

    Raises:
        ValueError: batches of several clouds, or another kind of features.
        ImportError: Open3D is not there.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> tr.reference.compare(pair.source, pair.target).descriptors_agree
        True
    """
    for name, cloud in (("source", source), ("target", target)):
        expect_in_words(len(cloud) == 1, name, "one cloud", f"{len(cloud)} clouds")
    one_of(features, "features", FEATURES)
    if truth is not None:
        expect_shape(truth, "truth", (4, 4))
        truth = truth.detach().to("cpu", torch.float64)
    source, target = source.to("cpu"), target.to("cpu")
    options = derive_options(source, target)[0] if options is None else options
    options = replace(options, match_neighbors=1, solver=options.solver_named("ransac"), effort="plain", refine="none")
    if features == "fpfh":
        options = options.without_color()
    given = source

    differences: tuple[DescriptorDifference, ...] = ()
    usable = refuse(source, target)[0] is None
    if usable:
        source, target = (downsample(cloud, [options.voxel_size]) for cloud in (source, target))
        usable = refuse(source, target)[0] is None
    as_they_are = replace(options, voxel_size=None)
    if usable:
        fpfh = fpfh_of(options)
        for name, cloud in (("source", source), ("target", target)):
            with_normals, _ = oriented(cloud, [description_of(options, colored=cloud.colors is not None)])
            differences += descriptor_differences(with_normals, fpfh.radius, fpfh.max_neighbors, name)
        _warm_up(source, target, as_they_are, features)
    results = (
        register(source, target, as_they_are, seed=seed),
        open3d.register(source, target, as_they_are, seed=seed, features=features),
    )
    sides = [_side(result, given, source, target, truth, options) for result in results]
    return Comparison(
        options=options,
        features=features,
        points=(len(source.points), len(target.points)),
        descriptors=differences,
        torchreg=sides[0],
        open3d=sides[1],
        shared_matches=shared(results[0].correspondences, results[1].correspondences),
    )


def shared(one: Correspondences, other: Correspondences) -> int:
    """How many matches of one pair are in both lists."""
    both = [set(zip(matches.source.tolist(), matches.target.tolist(), strict=True)) for matches in (one, other)]
    return len(both[0] & both[1])


def _warm_up(source: Clouds, target: Clouds, options: RegistrationOptions, features: str) -> None:
    """Register a few points with both, so that neither's times include what only a first call takes."""
    few = []
    for cloud in (source, target):
        index = torch.arange(0, len(cloud.points), -(-len(cloud.points) // _WARM_UP_POINTS))
        few.append(cloud.rows(index, torch.tensor([0, len(index)])))
    register(few[0], few[1], options)
    open3d.register(few[0], few[1], options, features=features)


def _side(
    result: RegistrationResult,
    given: Clouds,
    source: Clouds,
    target: Clouds,
    truth: Tensor | None,
    options: RegistrationOptions,
) -> Side:
    T, success = result.T_target_source, bool(result.success[0])
    errors, fit = None, None
    if success:
        fit = open3d.evaluate(source, target, T, options.inlier_threshold)
        if truth is not None:
            errors = pose_errors(given, truth, T[0])
    return Side(
        T_target_source=T[0],
        success=success,
        reason=result.reason[0],
        notes=result.notes[0],
        matches=len(result.correspondences.source),
        inliers=int(result.inliers.sum()),
        fitness=None if fit is None else float(fit.fitness[0]),
        inlier_rmse=None if fit is None else float(fit.inlier_rmse[0]),
        truth=errors,
        seconds={name: seconds for name, seconds in result.seconds if name not in _BEFORE},
    )
