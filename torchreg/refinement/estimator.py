"""What the loop asks of a kind of ICP: terms to be summed over correspondences, and the update from the sums."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor


class Matched(NamedTuple):
    """Some rows of the batch with their correspondences; k blocks of 256 rows, float64.

    Attributes:
        moved: (3, k, 256) source points in the target's frame, meters.
        partner: (A, k, 256) the target points nearest to them: x, y, z and what else the kind needs of them.
        inside: (k, 256) 1 where the two are a correspondence, 0 elsewhere.
        extra: (E, k, 256) what else the kind knows of source points.
        kernel_scale: (k, 1).
        color_weight: (k, 1).
    """

    moved: Tensor
    partner: Tensor
    inside: Tensor
    extra: Tensor
    kernel_scale: Tensor
    color_weight: Tensor


class Update(NamedTuple):
    """A rigid motion in the target's centered frame, to be made after the transform so far.

    Attributes:
        rotation: (B, 3, 3) float64.
        translation: (B, 3) float64, meters.
        usable: (B,) bool; where it is false the correspondences leave the motion open.
    """

    rotation: Tensor
    translation: Tensor
    usable: Tensor


class Estimator(NamedTuple):
    """One kind of ICP.

    Attributes:
        channels: C.
        terms: from matched rows to (C, k, 256); rows that are not inside give zeros.
        solve: from the sums (B, C) over every pair's rows, and the target's centers (B, 3), to the update.
    """

    channels: int
    terms: Callable[[Matched], Tensor]
    solve: Callable[[Tensor, Tensor], Update]
