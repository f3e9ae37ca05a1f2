"""The result of a registration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape
from torchreg.types.candidate import Candidate, StageCounts
from torchreg.types.clouds import Clouds
from torchreg.types.correspondences import Correspondences, MatchesBetween
from torchreg.types.failure import Failure
from torchreg.types.held import Listed, PerItem, PerRow, Times, held, numbers
from torchreg.types.loading import loadable
from torchreg.types.record import PackedBatch
from torchreg.types.shown import listed, several


@loadable
class HypothesisCounts(NamedTuple):
    """How many hypotheses of every pair reached each step, (B,) int64 each.

    Attributes:
        drawn: minimal samples drawn.
        kept: samples that passed the edge-length test.
        scored: hypotheses that bring their sample within the threshold, scored on all correspondences.

    Example:
        >>> import torchreg as tr
        >>> problem = tr.synthetic.match_problem(500, 0.8)
        >>> result = tr.ransac(problem.source, problem.target, problem.matches)
        >>> result.hypotheses.drawn.shape
        torch.Size([1])
    """

    drawn: Tensor
    kept: Tensor
    scored: Tensor


@dataclass(frozen=True, eq=False, repr=False)
class RegistrationResult(PackedBatch):
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

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> result = tr.register(pair.source, pair.target, effort="fast")
        >>> bool(result.success[0]), result.reason[0], result.T_target_source.shape
        (True, '', torch.Size([1, 4, 4]))
    """

    T_target_source: Tensor = held(numbers(4, 4))
    inliers: Tensor = held(PerRow(of="correspondences"))
    fitness: Tensor = held(numbers())
    inlier_rmse: Tensor = held(numbers())
    success: Tensor = held(PerItem(size=(), dtype=torch.bool))
    failure: tuple[Failure | None, ...] = held(Listed(what="one or None", shown=True))
    hypotheses: HypothesisCounts = held(PerItem())
    source: Clouds = held(PerItem())
    target: Clouds = held(PerItem())
    correspondences: Correspondences = held(MatchesBetween())
    options: tuple[Any, ...] = held(Listed(optional=True), default=())
    notes: tuple[tuple[str, ...], ...] = held(Listed(optional=True), default=())
    seconds: tuple[tuple[str, float], ...] = held(Times(), default=())
    probability: Tensor | None = held(numbers(), default=None)
    overlap: Tensor | None = held(numbers(), default=None)
    information: Tensor | None = held(numbers(6, 6), default=None)
    strength: Tensor | None = held(numbers(), default=None)
    runner_up: Tensor | None = held(numbers(4, 4), default=None)
    margin: Tensor | None = held(numbers(), default=None)
    candidates: tuple[tuple[Candidate, ...], ...] = held(Listed(optional=True), default=())
    stages: tuple[StageCounts, ...] = held(Listed(optional=True), default=())
    residual_median: Tensor | None = held(numbers(), default=None)
    residual_rms: Tensor | None = held(numbers(), default=None)
    residual_95: Tensor | None = held(numbers(), default=None)
    covariance: Tensor | None = held(numbers(6, 6), default=None)
    center: Tensor | None = held(numbers(3), default=None)
    axis_strength: Tensor | None = held(numbers(6), default=None)

    explainer: ClassVar[Callable[[RegistrationResult, int], str]]
    """Writes the text of ``explain``; set by ``torchreg``, since its report stands above the types."""

    def __post_init__(self) -> None:
        expect_shape(self.T_target_source, "T_target_source", ("B", 4, 4), torch.float64)
        pairs = self.T_target_source.shape[0]
        expect_shape(self.inliers, "inliers", (self.correspondences.source.shape[0],), torch.bool)
        for name in ("source", "target"):
            expect(len(getattr(self, name)) == pairs, name, f"one cloud per pair ({pairs})", len(getattr(self, name)))
        for counts, field in zip(self.hypotheses, self.hypotheses._fields, strict=True):
            expect_shape(counts, f"hypotheses.{field}", (pairs,))
        self._check_counts(pairs)

    def __len__(self) -> int:
        """The number of pairs, B."""
        return self.T_target_source.shape[0]

    @property
    def reason(self) -> tuple[str, ...]:
        """The text of each pair's ``failure``; empty where it succeeded."""
        return tuple("" if failure is None else failure.text for failure in self.failure)

    def _facts(self) -> Sequence[str]:
        refused = [f"pair {b}: {failure.kind}" for b, failure in enumerate(self.failure) if failure is not None]
        probability = "" if self.probability is None else f"probability {listed(self.probability.tolist())}; "
        return (
            f"{several(len(self), 'pairs')}, {int(self.success.sum())} registered, on {self.T_target_source.device}",
            f"{probability}fitness {listed(self.fitness.tolist())}",
            f"refused: {listed(refused)}" if refused else "none refused",
        )

    def explain(self, pair: int = 0) -> str:
        """Explain in words how much each stage of one pair had and lost, and the remedy most likely to help.

        Raises:
            ValueError: ``pair`` is not one of the result's.
        """
        return type(self).explainer(self, pair)
