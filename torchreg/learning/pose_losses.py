"""Loss of an estimated pose: the angle of its rotation error and the length of its translation error."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, expect_floating
from torchreg.geometry.numerics.lengths import safe_length


class PoseLoss(NamedTuple):
    """Errors of poses, one per pair.

    Attributes:
        rotation: (...,) radians in [0, pi], the angle of R_true^T R_estimated.
        translation: (...,) meters, ``|t_estimated - t_true|``.
        total: (...,) their weighted sum; train on its mean.

    Example:
        >>> import torch, torchreg as tr
        >>> T = torch.eye(4, dtype=torch.float64).expand(2, 4, 4)
        >>> tr.learning.pose_loss(T, T).total
        tensor([0., 0.], dtype=torch.float64)
    """

    rotation: Tensor
    translation: Tensor
    total: Tensor


@entry
def pose_loss(
    T_estimated: Tensor, T_true: Tensor, *, rotation_weight: float = 1.0, translation_weight: float = 1.0
) -> PoseLoss:
    """Rotation geodesic plus translation: the errors of Eq. (5) and (6) of the paper, in radians and meters.

    The angle comes from its sine and cosine together, ``atan2(|axial(R)|, trace(R) - 1)`` with R = R_true^T
    R_estimated: exact at small angles, and with a gradient whose entries are at most 1 everywhere. It has a kink
    where the rotations are equal and one where they lie 180 degrees apart, as ``|x|`` has one at 0: exactly there the
    gradient is zero, a subgradient. The same holds for a translation that is exactly right.

    The translation error depends on where the frames have their origin. Weights of 1 say that a radian costs as much
    as a meter; the reciprocal of the extent of the clouds is a natural ``translation_weight``.

    Args:
        T_estimated: (..., 4, 4) rigid, meters.
        T_true: (..., 4, 4) likewise, of a shape that broadcasts with it; taken to the dtype of the estimate.
        rotation_weight: per radian, at least 0.
        translation_weight: per meter, at least 0.

    Returns:
        Errors per pair. Gradients flow to both transforms, twice if wanted.

    Raises:
        ValueError: shapes that do not fit, or a negative weight.

    Example:
        >>> import torch
        >>> moved = torch.eye(4)
        >>> moved[0, 3] = 2.0
        >>> pose_loss(moved, torch.eye(4)).total
        tensor(2.)
    """
    for value, name in ((T_estimated, "T_estimated"), (T_true, "T_true")):
        expect_floating(value, name)
        expect(value.shape[-2:] == (4, 4), name, "(..., 4, 4)", value)
    for weight, name in ((rotation_weight, "rotation_weight"), (translation_weight, "translation_weight")):
        expect(0 <= weight < float("inf"), name, "a finite number of at least 0", weight)
    T_true = T_true.to(T_estimated.dtype)
    rotation = _angle(T_true[..., :3, :3].transpose(-1, -2) @ T_estimated[..., :3, :3])
    translation = safe_length(T_estimated[..., :3, 3] - T_true[..., :3, 3])
    return PoseLoss(rotation, translation, rotation_weight * rotation + translation_weight * translation)


def _angle(R: Tensor) -> Tensor:
    """Angles (...,) of rotations (..., 3, 3)."""
    twice_sine = safe_length(
        torch.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], dim=-1)
    )
    twice_cosine = torch.diagonal(R, dim1=-2, dim2=-1).sum(dim=-1) - 1
    neither = (twice_sine == 0) & (twice_cosine == 0)  # never of a rotation, but maybe of a matrix still in training
    return torch.atan2(twice_sine, torch.where(neither, 1, twice_cosine))
