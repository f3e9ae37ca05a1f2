"""Errors of an estimated transform against the true one, the paper's Eq. (5) to (7), and registration recall."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, expect_in_words, expect_shape, positive
from torchreg.geometry.se3 import apply_rotation
from torchreg.types import Clouds


class PoseErrors(NamedTuple):
    """Errors of one transform against the true one, as plain numbers.

    Attributes:
        rre_degrees: relative rotation error (Eq. 5).
        rte_meters: relative translation error (Eq. 6), in frames whose zeros are the origin of the source and its true
            place: with coordinates of a map it tells of the scene, not of a zero thousands of kilometers away.
        rmse_meters: root mean square distance between the source points under the two transforms (Eq. 7).

    Example:
        >>> import torchreg as tr
        >>> tr.metrics.PoseErrors(rre_degrees=0.5, rte_meters=0.02, rmse_meters=0.03).rte_meters
        0.02
    """

    rre_degrees: float
    rte_meters: float
    rmse_meters: float


@entry
def pose_errors(source: Clouds, T_true: Tensor, T_estimated: Tensor) -> PoseErrors:
    """All three errors of a transform of one cloud, in float64 on the CPU. No gradients.

    Args:
        source: one cloud, of a batch ``clouds[b]``.
        T_true: (4, 4), meters, origins included.
        T_estimated: (4, 4), likewise.

    Raises:
        ValueError: several clouds, an empty one, or transforms of another shape.

    Example:
        >>> cloud = Clouds(points=torch.rand(9, 3))
        >>> pose_errors(cloud, torch.eye(4), torch.eye(4))
        PoseErrors(rre_degrees=0.0, rte_meters=0.0, rmse_meters=0.0)
    """
    expect_in_words(len(source) == 1, "source", "a batch of one (cloud[b] picks one)", f"{len(source)} clouds")
    expect_shape(T_true, "T_true", (4, 4))
    expect_shape(T_estimated, "T_estimated", (4, 4))
    points = source.points.detach().cpu().to(torch.float64) + source.origin.cpu()
    pair = (T_true.detach().cpu().to(torch.float64), T_estimated.detach().cpu().to(torch.float64))
    return PoseErrors(float(rre(*pair)), float(rmse(*pair, source.origin.cpu())), float(rmse(*pair, points)))


@entry
def rre(T_true: Tensor, T_estimated: Tensor) -> Tensor:
    """Relative rotation error, degrees (Eq. 5): the angle of R_true^T R_estimated.

    Computed from sine and cosine together, so that small angles keep their digits (the arc cosine of Eq. (5)
    loses them below 1e-6 degrees).

    Args:
        T_true: (..., 4, 4).
        T_estimated: (..., 4, 4).

    Returns:
        (...,) in [0, 180]. Gradients flow, except at 0 and 180 degrees.

    Example:
        >>> import torch, torchreg as tr
        >>> quarter = torch.eye(4, dtype=torch.float64)
        >>> quarter[:2, :2] = torch.tensor([[0.0, -1.0], [1.0, 0.0]])
        >>> tr.metrics.rre(torch.eye(4, dtype=torch.float64), quarter)
        tensor(90., dtype=torch.float64)
    """
    _check(T_true, T_estimated)
    R = T_true[..., :3, :3].transpose(-1, -2) @ T_estimated[..., :3, :3]
    axis = torch.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], dim=-1)
    twice_cosine = torch.diagonal(R, dim1=-2, dim2=-1).sum(dim=-1) - 1
    return torch.rad2deg(torch.atan2(torch.linalg.vector_norm(axis, dim=-1), twice_cosine))


@entry
def rte(T_true: Tensor, T_estimated: Tensor) -> Tensor:
    """Relative translation error, meters (Eq. 6): ``|t_true - t_estimated|``, (...,). Gradients flow.

    Example:
        >>> import torch, torchreg as tr
        >>> shifted = torch.eye(4, dtype=torch.float64)
        >>> shifted[0, 3] = 0.25
        >>> tr.metrics.rte(torch.eye(4, dtype=torch.float64), shifted)
        tensor(0.2500, dtype=torch.float64)
    """
    _check(T_true, T_estimated)
    difference: Tensor = T_true[..., :3, 3] - T_estimated[..., :3, 3]
    length: Tensor = torch.linalg.vector_norm(difference, dim=-1)
    return length


@entry
def rmse(T_true: Tensor, T_estimated: Tensor, points: Tensor) -> Tensor:
    """Root mean square distance, meters (Eq. 7), between the source points under the two transforms.

    Args:
        T_true: (..., 4, 4).
        T_estimated: (..., 4, 4).
        points: (P, 3) of the source, meters, in the frame that the transforms map from.

    Returns:
        (...,). Gradients flow.

    Example:
        >>> import torch, torchreg as tr
        >>> T = torch.eye(4, dtype=torch.float64)
        >>> shifted = T.clone()
        >>> shifted[0, 3] = 0.25
        >>> tr.metrics.rmse(T, shifted, torch.rand(50, 3, dtype=torch.float64))
        tensor(0.2500, dtype=torch.float64)
    """
    _check(T_true, T_estimated)
    expect_shape(points, "points", ("P", 3))
    expect(len(points) > 0, "points", "at least one point", points)
    difference = (T_true - T_estimated)[..., :3, :]
    wide = points.to(difference.dtype)
    moved = apply_rotation(difference[..., None, :, :3], wide) + difference[..., None, :, 3]  # (..., P, 3)
    mean: Tensor = (moved * moved).sum(dim=-1).mean(dim=-1)
    return torch.sqrt(mean)


@entry
def recalled_by_error(
    T_true: Tensor, T_estimated: Tensor, *, rotation: float = 15.0, translation: float = 0.3
) -> Tensor:
    """(B,) bool: rotation error (degrees) and translation error (meters) both below their bounds.

    The bounds are those of Choy, Dong and Koltun, Deep Global Registration, CVPR 2020,
    doi:10.1109/CVPR42600.2020.00259, for 3DMatch: 15 degrees and 0.3 m.

    Example:
        >>> import torch, torchreg as tr
        >>> T = torch.eye(4, dtype=torch.float64).expand(2, 4, 4)
        >>> tr.metrics.recalled_by_error(T, T, rotation=15.0, translation=0.3)
        tensor([True, True])
    """
    positive(rotation, "rotation")
    positive(translation, "translation")
    return (rre(T_true, T_estimated) < rotation) & (rte(T_true, T_estimated) < translation)


@entry
def recalled_by_rmse(errors: Tensor, *, bound: float = 0.2) -> Tensor:
    """(B,) bool: the root mean square error (B,) of true correspondences is below the bound.

    Choi, Zhou and Koltun, Robust Reconstruction of Indoor Scenes, CVPR 2015, doi:10.1109/CVPR.2015.7299195:
    0.2 m; the errors are ``rmse`` over the points that overlap under the truth.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.metrics.recalled_by_rmse(torch.tensor([0.05, 0.4]))
        tensor([ True, False])
    """
    positive(bound, "bound")
    return errors < bound


@entry
def registration_recall(recalled: Tensor) -> Tensor:
    """Share of pairs (B,) bool that are recalled, a scalar; at least one pair is needed.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.metrics.registration_recall(torch.tensor([True, True, False, True]))
        tensor(0.7500, dtype=torch.float64)
    """
    expect(recalled.numel() > 0, "recalled", "at least one pair", recalled)
    return recalled.double().mean()


def _check(T_true: Tensor, T_estimated: Tensor) -> None:
    expect(T_true.shape[-2:] == (4, 4), "T_true", "(..., 4, 4)", T_true)
    expect(T_estimated.shape[-2:] == (4, 4), "T_estimated", "(..., 4, 4)", T_estimated)
