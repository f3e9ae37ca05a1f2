"""The result of a refinement."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape


@dataclass(frozen=True, eq=False)
class IcpResult:
    """The refined transforms of ``B`` pairs. A pair that failed is data: ``converged`` false, and its ``reason``.

    Attributes:
        T_target_source: (B, 4, 4) float64: x_target = R x_source + t in meters, origins included. Where a pair
            failed, the last transform that was valid: at first the one it started from.
        fitness: (B,) float64, share of source points with a target point nearer than ``max_distance`` (of the
            last level, on its clouds); as Open3D.
        inlier_rmse: (B,) float64, meters, over those points; 0 where there are none; as Open3D.
        iterations: (B,) int64, updates made, over all levels.
        converged: (B,) bool: fitness and inlier_rmse changed by less than asked before the iterations ran out;
            with levels, on the last.
        reason: why a pair did not converge, empty where it did.
    """

    T_target_source: Tensor
    fitness: Tensor
    inlier_rmse: Tensor
    iterations: Tensor
    converged: Tensor
    reason: tuple[str, ...]

    def __post_init__(self) -> None:
        expect_shape(self.T_target_source, "T_target_source", ("B", 4, 4), torch.float64)
        pairs = len(self)
        expect_shape(self.fitness, "fitness", (pairs,), torch.float64)
        expect_shape(self.inlier_rmse, "inlier_rmse", (pairs,), torch.float64)
        expect_shape(self.iterations, "iterations", (pairs,), torch.int64)
        expect_shape(self.converged, "converged", (pairs,), torch.bool)
        expect(len(self.reason) == pairs, "reason", f"one text per pair ({pairs})", self.reason)

    def __len__(self) -> int:
        """The number of pairs, B."""
        return self.T_target_source.shape[0]
