"""The result of a refinement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.errors import expect_shape
from torchreg.types import Failure
from torchreg.types.held import Listed, PerItem, held, numbers
from torchreg.types.record import PackedBatch
from torchreg.types.shown import listed, several


@dataclass(frozen=True, eq=False, repr=False)
class IcpResult(PackedBatch):
    """The refined transforms of ``B`` pairs. A failed pair is data: ``success`` false, and its ``failure``.

    Attributes:
        T_target_source: (B, 4, 4) float64: x_target = R x_source + t in meters, origins included. Where a pair
            failed, the last transform that was valid: at first the one it started from.
        fitness: (B,) float64, share of source points with a target point nearer than ``max_distance`` (of the
            last level, on its clouds); as Open3D.
        inlier_rmse: (B,) float64, meters, over those points; 0 where there are none; as Open3D.
        iterations: (B,) int64, updates made, over all levels.
        converged: (B,) bool: fitness and inlier_rmse changed by less than asked before the iterations ran out;
            with levels, on the last.
        failure: why a pair did not converge, ``None`` where it did, one per pair; ``reason`` is its text.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(200, 3))
        >>> result = tr.icp(cloud, cloud, torch.eye(4, dtype=torch.float64))
        >>> bool(result.success[0]), float(result.fitness[0])
        (True, 1.0)
    """

    T_target_source: Tensor = held(numbers(4, 4))
    fitness: Tensor = held(numbers())
    inlier_rmse: Tensor = held(numbers())
    iterations: Tensor = held(PerItem(size=(), dtype=torch.int64))
    converged: Tensor = held(PerItem(size=(), dtype=torch.bool))
    failure: tuple[Failure | None, ...] = held(Listed(what="one or None", shown=True))

    def __post_init__(self) -> None:
        expect_shape(self.T_target_source, "T_target_source", ("B", 4, 4), torch.float64)
        self._check_counts(len(self))

    def __len__(self) -> int:
        """The number of pairs, B."""
        return self.T_target_source.shape[0]

    @property
    def success(self) -> Tensor:
        """(B,) bool, which pairs converged. That a pose is right ``register`` says, and ``verify``."""
        return self.converged

    @property
    def reason(self) -> tuple[str, ...]:
        """The text of each pair's ``failure``; empty where it converged."""
        return tuple("" if failure is None else failure.text for failure in self.failure)

    def _facts(self) -> Sequence[str]:
        failed = [f"pair {b}: {failure.kind}" for b, failure in enumerate(self.failure) if failure is not None]
        return (
            f"{several(len(self), 'pairs')}, {int(self.converged.sum())} converged, on {self.T_target_source.device}",
            f"fitness {listed(self.fitness.tolist())}; inlier_rmse {listed(self.inlier_rmse.tolist())}",
            f"failed: {listed(failed)}" if failed else "none failed",
        )
