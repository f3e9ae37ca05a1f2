"""The result of a registration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape
from torchreg.types.candidate import Candidate, StageCounts
from torchreg.types.clouds import Clouds
from torchreg.types.correspondences import Correspondences
from torchreg.types.failure import Failure


class HypothesisCounts(NamedTuple):
    """How many hypotheses of every pair reached each step, (B,) int64 each.

    Attributes:
        drawn: minimal samples drawn.
        kept: samples that passed the edge-length test.
        scored: hypotheses that bring their sample within the threshold, scored on all correspondences.
    """

    drawn: Tensor
    kept: Tensor
    scored: Tensor


_PER_PAIR: dict[str, tuple[int, ...]] = {
    "fitness": (),
    "inlier_rmse": (),
    "probability": (),
    "overlap": (),
    "information": (6, 6),
    "strength": (),
    "runner_up": (4, 4),
    "margin": (),
    "residual_median": (),
    "residual_rms": (),
    "residual_95": (),
    "covariance": (6, 6),
    "center": (3,),
    "axis_strength": (6,),
}
"""The size of fields that are float64 numbers of every pair."""


@dataclass(frozen=True, eq=False)
class RegistrationResult:
    """The transforms of ``B`` pairs. A failed pair is data: ``success`` false, and its ``failure``.

    Attributes:
        T_target_source: (B, 4, 4) float64, rigid: x_target = R x_source + t in meters, in the frames of the
            files (origins included). The identity stands only beside ``success`` = False.
        inliers: (M,) bool, which of ``correspondences`` the transform brings within the inlier threshold.
        fitness: (B,) float64, share of source points with a target point nearer than the inlier threshold
            under the transform; as Open3D's ``evaluate_registration``.
        inlier_rmse: (B,) float64, meters, over those points; as Open3D.
        success: (B,) bool.
        failure: why a pair did not succeed, ``None`` where it did, one per pair; ``reason`` is its text.
        hypotheses: counts of every pair.
        source: B clouds, those that were matched: as a solver got them, in ``register`` the thinned clouds with
            their normals.
        target: B clouds, likewise.
        correspondences: the matches to which ``inliers`` belongs; their rows are those of ``source`` and ``target``.
        options: the ``RegistrationOptions`` of every pair, derived numbers included; empty when made by a solver alone.
        notes: remarks on every pair, such as that it had no colors.
        seconds: time of every stage, by name, in order; empty when made by ``ransac``.
        probability: (B,) float64, calibrated, that the transform is right; ``None`` when made by a solver alone,
            as are all that follow.
        overlap: (B,) float64, mean over both directions of the share of points with a partner nearer than the
            inlier threshold.
        information: (B, 6, 6) float64, in the convention of Open3D's ``get_information_matrix_from_point_clouds``:
            rotations before translations, over the target points that are partners of source points, in the frame of
            the target's file. Summed over an even choice of the source points and scaled up to all of them.
        strength: (B,) float64 in [0, 1], how evenly the surfaces constrain the pose: the square root of the least over
            the largest eigenvalue of the point-to-plane information, rotations scaled by the size of the
            overlap. Near 0 the pose slides along a plane, an axis or turns about one.
        runner_up: (B, 4, 4) float64, the best distinct other pose; NaN where there is none.
        margin: (B,) float64, log-odds of the pose less those of the runner-up; infinite where there is none.
        candidates: of every pair, the poses that were weighed, best first, as they were before refinement; overlap,
            information, strength, runner_up and margin are those of the pose then, too.
        stages: of every pair, counts of each stage.
        residual_median: (B,) float64, meters, median of the distances between the surfaces of the overlap: of the small
            planes (surfels) of the source that lie on those of the target, each to its partner's plane. NaN for a pair
            that was not refined; ``None``, as are all that follow, where no refinement was asked for.
        residual_rms: (B,) float64, meters, their root mean square.
        residual_95: (B,) float64, meters, below which 95 % of them are.
        covariance: (B, 6, 6) float64, of the pose: of a small turn about ``center`` (radians; x, y, z) and a shift
            (meters) in the frame of the target's file, in this order: x_true = x + turn x (x - center) + shift.
        center: (B, 3) float64, meters, in the frame of the target's file: the middle of the overlap.
        axis_strength: (B, 6) float64 in [0, 1], how firmly the surfaces hold turns about x, y and z through ``center``
            and shifts along them: the square root of the share of the surfaces' resistance that is left when all other
            motions are free. 0.58 for each shift in a cube, 0 along a corridor.
    """

    T_target_source: Tensor
    inliers: Tensor
    fitness: Tensor
    inlier_rmse: Tensor
    success: Tensor
    failure: tuple[Failure | None, ...]
    hypotheses: HypothesisCounts
    source: Clouds
    target: Clouds
    correspondences: Correspondences
    options: tuple[Any, ...] = ()
    notes: tuple[tuple[str, ...], ...] = ()
    seconds: tuple[tuple[str, float], ...] = ()
    probability: Tensor | None = None
    overlap: Tensor | None = None
    information: Tensor | None = None
    strength: Tensor | None = None
    runner_up: Tensor | None = None
    margin: Tensor | None = None
    candidates: tuple[tuple[Candidate, ...], ...] = ()
    stages: tuple[StageCounts, ...] = ()
    residual_median: Tensor | None = None
    residual_rms: Tensor | None = None
    residual_95: Tensor | None = None
    covariance: Tensor | None = None
    center: Tensor | None = None
    axis_strength: Tensor | None = None

    explainer: ClassVar[Callable[[RegistrationResult, int], str]]
    """Writes the text of ``explain``; set by ``torchreg``, since its report stands above the types."""

    def __post_init__(self) -> None:
        expect_shape(self.T_target_source, "T_target_source", ("B", 4, 4), torch.float64)
        pairs = self.T_target_source.shape[0]
        expect_shape(self.inliers, "inliers", (self.correspondences.source.shape[0],), torch.bool)
        expect_shape(self.success, "success", (pairs,), torch.bool)
        expect(len(self.failure) == pairs, "failure", f"one or None per pair ({pairs})", self.failure)
        for name in ("source", "target"):
            expect(len(getattr(self, name)) == pairs, name, f"one cloud per pair ({pairs})", len(getattr(self, name)))
        for counts, field in zip(self.hypotheses, self.hypotheses._fields, strict=True):
            expect_shape(counts, f"hypotheses.{field}", (pairs,))
        for name, size in _PER_PAIR.items():
            value = getattr(self, name)
            if value is not None:
                expect_shape(value, name, (pairs, *size), torch.float64)
        for name in ("options", "notes", "candidates", "stages"):
            count = len(getattr(self, name))
            expect(count in (0, pairs), name, f"none or one item per pair ({pairs})", count)

    def __len__(self) -> int:
        """The number of pairs, B."""
        return self.T_target_source.shape[0]

    @property
    def reason(self) -> tuple[str, ...]:
        """The text of each pair's ``failure``; empty where it succeeded."""
        return tuple("" if failure is None else failure.text for failure in self.failure)

    def explain(self, pair: int = 0) -> str:
        """Explain in words how much each stage of one pair had and lost, and the remedy most likely to help.

        Raises:
            ValueError: ``pair`` is not one of the result's.
        """
        return type(self).explainer(self, pair)
