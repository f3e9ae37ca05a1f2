"""The verdict on transforms that came from elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchreg.types.candidate import Candidate
from torchreg.types.clouds import Clouds
from torchreg.types.failure import Failure
from torchreg.types.held import Listed, PerItem, held, numbers
from torchreg.types.record import PackedBatch
from torchreg.types.result import RegistrationResult
from torchreg.types.shown import listed, several


@dataclass(frozen=True, eq=False, repr=False)
class Verification(PackedBatch):
    """How far the given transforms of ``B`` pairs can be trusted. A wrong one is data: ``success`` false, and why.

    Transforms are in meters, between the frames of the files (origins included).

    Attributes:
        T_target_source: (B, 4, 4) float64, as given: x_target = R x_source + t.
        success: (B,) bool, whether the given transform is held to be right.
        failure: why it is not, ``None`` where it is, one per pair; ``reason`` is its text.
        probability: (B,) float64, calibrated, that the given transform is right: that the pose it settles to is, and
            that the given one lies within the inlier threshold of that pose. 0 where it lies farther away.
        settled: (B, 4, 4) float64, the pose that the given one settles to: where ICP takes it, or the best of all that
            were weighed within a few inlier thresholds of that, where this one is clearly better; refined as
            ``register`` refines, where it is about the pose of a search that succeeds. NaN where the clouds cannot be
            registered at all.
        deviation_meters: (B,) float64, root mean square distance between the source points under the given and under
            the settled pose. NaN where there is none.
        deviation_degrees: (B,) float64, the angle between the rotations of both, likewise.
        likeliest: (B, 4, 4) float64, the pose that the search holds the most probable, which may be the settled one or
            close to it, refined as ``register`` refines where the search succeeds; only ``search.success`` says
            whether it is trusted. NaN where there is none.
        fitness: (B,) float64, at the given transform, not refined: share of source points with a target point nearer
            than the inlier threshold; as Open3D's ``evaluate_registration``.
        inlier_rmse: (B,) float64, meters, over those points; as Open3D.
        overlap: (B,) float64, at the given transform: mean over both directions of the share of points with a partner
            nearer than the inlier threshold.
        residual_median: (B,) float64, meters, at the given transform: median of the distances between the surfaces of
            the overlap, as in ``RegistrationResult``. NaN where no surfaces lie on each other, or none were looked at.
        residual_rms: (B,) float64, meters, their root mean square.
        residual_95: (B,) float64, meters, below which 95 % of them are.
        candidate: of every pair all that speaks for and against the given transform, exactly as given; ``None`` where
            the clouds cannot be registered.
        settled_candidate: the same of the settled pose, as it was before refinement.
        rival: of every pair the best pose that is not about the settled one, ``None`` where no other was weighed.
        search: what ``register`` finds with the given transform among its candidates: it has the clouds that were
            compared, thinned, with options, notes, times, candidates and counts.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> verification = tr.verify(pair.source, pair.target, pair.T_target_source)
        >>> verification.success, verification.deviation_meters.shape
        (tensor([False]), torch.Size([1]))
    """

    T_target_source: Tensor = held(numbers(4, 4))
    success: Tensor = held(PerItem(size=(), dtype=torch.bool))
    failure: tuple[Failure | None, ...] = held(Listed(what="one or None", shown=True))
    probability: Tensor = held(numbers())
    settled: Tensor = held(numbers(4, 4))
    deviation_meters: Tensor = held(numbers())
    deviation_degrees: Tensor = held(numbers())
    likeliest: Tensor = held(numbers(4, 4))
    fitness: Tensor = held(numbers())
    inlier_rmse: Tensor = held(numbers())
    overlap: Tensor = held(numbers())
    residual_median: Tensor = held(numbers())
    residual_rms: Tensor = held(numbers())
    residual_95: Tensor = held(numbers())
    candidate: tuple[Candidate | None, ...] = held(Listed(what="one or None"))
    settled_candidate: tuple[Candidate | None, ...] = held(Listed(what="one or None"))
    rival: tuple[Candidate | None, ...] = held(Listed(what="one or None"))
    search: RegistrationResult = held(PerItem())

    explainer: ClassVar[Callable[[Verification, int], str]]
    """Writes the text of ``explain``; set by ``torchreg``, since its report stands above the types."""

    def __post_init__(self) -> None:
        self._check_counts(len(self.search))

    def __len__(self) -> int:
        """The number of pairs, B."""
        return len(self.search)

    @property
    def source(self) -> Clouds:
        """The B source clouds that were compared: thinned, with normals."""
        return self.search.source

    @property
    def target(self) -> Clouds:
        """The B target clouds, likewise."""
        return self.search.target

    @property
    def options(self) -> tuple[Any, ...]:
        """The ``RegistrationOptions`` of every pair, derived numbers included."""
        return self.search.options

    @property
    def notes(self) -> tuple[tuple[str, ...], ...]:
        """Remarks on every pair, such as that it had no colors."""
        return self.search.notes

    @property
    def seconds(self) -> tuple[tuple[str, float], ...]:
        """Time of every stage, by name, in order."""
        return self.search.seconds

    @property
    def reason(self) -> tuple[str, ...]:
        """The text of each pair's ``failure``; empty where the given transform is held to be right."""
        return tuple("" if failure is None else failure.text for failure in self.failure)

    def _facts(self) -> Sequence[str]:
        refused = [f"pair {b}: {failure.kind}" for b, failure in enumerate(self.failure) if failure is not None]
        return (
            f"{several(len(self), 'transforms')}, {int(self.success.sum())} held to be right",
            f"probability {listed(self.probability.tolist())}; overlap {listed(self.overlap.tolist())}",
            f"refused: {listed(refused)}" if refused else "none refused",
        )

    def explain(self, pair: int = 0) -> str:
        """Explain in words what speaks for and against the given transform of one pair, and what to do.

        Raises:
            ValueError: ``pair`` is not one of the result's.
        """
        return type(self).explainer(self, pair)
