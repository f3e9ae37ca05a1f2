"""Rigid transforms as 4x4 matrices, ``T_to_from``: x_to = R x_from + t; rotations as quaternions."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, expect_shape
from torchreg.geometry.rigid_check import expect_all_rigid
from torchreg.types import Clouds
from torchreg.types.packing import spans


def rigid(rotation: Tensor, translation: Tensor) -> Tensor:
    """The matrix (..., 4, 4) of a rotation (..., 3, 3) and a translation (..., 3). Gradients flow."""
    expect(rotation.shape[-2:] == (3, 3), "rotation", "(..., 3, 3)", rotation)
    expect(translation.shape == rotation.shape[:-1], "translation", f"{tuple(rotation.shape[:-1])}", translation)
    top = torch.cat([rotation, translation[..., None]], dim=-1)  # (..., 3, 4)
    last = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, last], dim=-2)


def inverse(T: Tensor) -> Tensor:
    """The inverse of rigid transforms (..., 4, 4), by transposition of the rotation. Gradients flow."""
    expect(T.shape[-2:] == (4, 4), "T", "(..., 4, 4)", T)
    back = T[..., :3, :3].transpose(-1, -2)
    return rigid(back, -apply_rotation(back, T[..., :3, 3]))


def compose(T_c_b: Tensor, T_b_a: Tensor) -> Tensor:
    """The rigid transforms (..., 4, 4) that do ``T_b_a`` first. Shapes broadcast; gradients flow.

    By basic operations alone: a transform of a batch has the bits that it has alone, as matrix products do not promise.
    """
    R = T_c_b[..., :3, :3]
    columns = apply_rotation(R[..., None, :, :], T_b_a[..., :3, :3].transpose(-1, -2))  # (..., column, 3)
    shift = apply_rotation(R, T_b_a[..., :3, 3]) + T_c_b[..., :3, 3]
    return rigid(columns.transpose(-1, -2), shift)


def apply_rotation(rotation: Tensor, points: Tensor) -> Tensor:
    """Rotate points (..., 3) by (..., 3, 3) with basic operations alone, so that shapes do not change bits."""
    x, y, z = points.unbind(-1)
    rows = [rotation[..., i, 0] * x + rotation[..., i, 1] * y + rotation[..., i, 2] * z for i in range(3)]
    return torch.stack(rows, dim=-1)


def apply(T: Tensor, points: Tensor) -> Tensor:
    """Transform points (P, 3) by one matrix (4, 4). Gradients flow to both."""
    expect_shape(T, "T", (4, 4))
    expect_shape(points, "points", ("P", 3))
    return apply_rotation(T[:3, :3], points) + T[:3, 3]


def quaternion_wxyz(rotation: Tensor) -> Tensor:
    """The unit quaternions (w, x, y, z), (..., 4) with w >= 0, of rotations (..., 3, 3); any floating dtype stays."""
    from kornia.geometry.conversions import rotation_matrix_to_quaternion

    # eps=0: kornia below 0.9 adds it under the root, which costs half the digits of float64.
    quaternion: Tensor = rotation_matrix_to_quaternion(rotation, eps=0.0)
    unit = quaternion / torch.linalg.vector_norm(quaternion, dim=-1, keepdim=True)
    return torch.where(unit[..., :1] < 0, -unit, unit)


@entry
def transform(clouds: Clouds, T_to_from: Tensor) -> Clouds:
    """Move clouds: points, normals and viewpoints, in float64 and with their origins.

    Args:
        clouds: B clouds in frames "from".
        T_to_from: (4, 4) for all clouds or (B, 4, 4), rigid, meters.

    Returns:
        The clouds in frames "to", with an origin each of R origin + t, so that points stay small numbers. A
        viewpoint that is assumed moves with its cloud and stays assumed.

    Raises:
        ValueError: another shape, numbers that are not finite, or a matrix that is not rigid within 1e-3, such as a
            reflection or a scale.

    Example:
        >>> import torch, torchreg as tr
        >>> T = torch.eye(4, dtype=torch.float64)
        >>> T[:2, :2] = torch.tensor([[0.0, -1.0], [1.0, 0.0]])  # a quarter turn about z
        >>> tr.transform(tr.Clouds(torch.tensor([[2.0, 0.0, 0.0]])), T).points
        tensor([[0., 2., 0.]])
    """
    T = T_to_from.to(device=clouds.device, dtype=torch.float64)
    expect(T.shape in ((4, 4), (len(clouds), 4, 4)), "T_to_from", f"(4, 4) or ({len(clouds)}, 4, 4)", T_to_from)
    expect_all_rigid(T, "T_to_from", 1e-3)
    T = T.expand(len(clouds), 4, 4)

    def rotated(values: Tensor | None) -> Tensor | None:
        if values is None:
            return None
        wide = values.to(torch.float64)
        parts = [apply_rotation(T[b, :3, :3], wide[i:j]) for b, (i, j) in enumerate(spans(clouds.offsets))]
        return torch.cat(parts).to(values.dtype) if parts else values

    points, normals = rotated(clouds.points), rotated(clouds.normals)
    viewpoint = clouds.viewpoint
    if viewpoint is not None:
        viewpoint = apply_rotation(T[:, :3, :3], viewpoint.to(torch.float64)).to(viewpoint.dtype)
    return Clouds(
        points=clouds.points if points is None else points,
        offsets=clouds.offsets,
        colors=clouds.colors,
        normals=normals,
        origin=apply_rotation(T[:, :3, :3], clouds.origin) + T[:, :3, 3],
        viewpoint=viewpoint,
        viewpoint_assumed=clouds.viewpoint_assumed,
    )
