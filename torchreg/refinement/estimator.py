"""A kind of ICP as the loop sees it: terms to be summed over correspondences, and the update from the sums.

A new kind is one file with its ``IcpKind`` and one line in ``options.KINDS``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from torchreg.refinement.kernels import Kernel
from torchreg.types import Clouds


class MatchedBlocks(NamedTuple):
    """Some rows of the batch with their correspondences; k blocks of 256 rows, float64."""

    moved: Tensor  # (3, k, 256) source points in the target's frame, meters
    partner: Tensor  # (A, k, 256) the target points nearest to them: x, y, z and the other columns of the kind
    inside: Tensor  # (k, 256) 1 where the two are a correspondence, 0 elsewhere
    extra: Tensor  # (E, k, 256) the kind's columns of source points
    rotation: Tensor  # (k, 3, 3) from the source's frame to the target's
    kernel_scale: Tensor  # (k, 1)
    color_weight: Tensor  # (k, 1)


class Update(NamedTuple):
    """A rigid motion in the target's centered frame, to be made after the transform so far."""

    rotation: Tensor  # (B, 3, 3) float64
    translation: Tensor  # (B, 3) float64, meters
    usable: Tensor  # (B,) bool; where it is false the correspondences do not determine the motion


class Estimator(NamedTuple):
    """The terms that the loop sums over correspondences, and the update from the sums.

    Attributes:
        channels: C.
        terms: from matched rows to (C, k, 256); rows that are not inside give zeros.
        solve: from the sums (B, C) over every pair's rows, and the target's centers (B, 3), to the update.
        compiled: the name of the kernel that iterates with these terms, empty where there is none.
    """

    channels: int
    terms: Callable[[MatchedBlocks], Tensor]
    solve: Callable[[Tensor, Tensor], Update]
    compiled: str = ""


class IcpKind(NamedTuple):
    """One kind of ICP: the attributes of clouds that it needs, and how it estimates the motion.

    Attributes:
        needs: pairs of ("source" or "target", attribute of ``Clouds``).
        columns: from the source and target clouds and the largest distance (T,) of every target, meters, to what the
            estimator reads of target points (N, A), x, y, z first, and of source points (P, E).
        estimator: from the kernel that weighs residuals to the estimator.
        beside: from clouds to coordinates (P, S - 3) in which, multiplied by the options' ``color_scale``, the nearest
            points are searched beside x, y, z; ``None`` searches in space alone. What the estimator reads of target
            points then has them after x, y, z.
    """

    needs: tuple[tuple[str, str], ...]
    columns: Callable[[Clouds, Clouds, Tensor], tuple[Tensor, Tensor]]
    estimator: Callable[[Kernel], Estimator]
    beside: Callable[[Clouds], Tensor] | None = None
