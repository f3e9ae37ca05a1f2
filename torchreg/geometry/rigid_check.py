"""The check of a matrix from outside that should be a rigid transform: what is wrong with it, in words."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.errors import expect, expect_in_words
from torchreg.geometry.numerics.derivatives import transformed

RIGID = 1e-4  # of R R^T - 1 and of the last row


def expect_rigid(T: Tensor, name: str, tolerance: float = RIGID) -> None:
    """Check that a matrix (4, 4) float64 is a rotation and a translation, by default within 1e-4.

    Raises:
        ValueError: another shape, numbers that are not finite, a last row other than 0 0 0 1, or an upper left part
            that is not a rotation: a reflection, a scale or a shear, and how large.
    """
    expect(T.shape == (4, 4), name, "(4, 4) numbers", tuple(T.shape))
    T = T.detach().cpu()
    expect(bool(T.isfinite().all()), name, "finite numbers", T.tolist())
    last = T[3] - T.new_tensor([0.0, 0.0, 0.0, 1.0])
    expect(bool((last.abs() <= tolerance).all()), name, "a last row 0 0 0 1", T[3].tolist())
    R = T[:3, :3]
    determinant, off = float(torch.linalg.det(R)), float((R @ R.t() - torch.eye(3, dtype=R.dtype)).abs().max())
    if off <= tolerance and determinant > 0:
        return
    expected = f"a rotation: R R^T within {tolerance:g} of the identity, determinant 1"
    scales = torch.linalg.svdvals(R).tolist()
    mirrored = "a reflection, " if determinant < 0 else ""
    scaled = f"a scale of {sum(scales) / 3:.6g}, " if scales[0] - scales[2] <= tolerance * scales[0] else ""
    scaled = scaled if off > tolerance else ""
    words = f"{mirrored}{scaled}R R^T off by {off:.3g}, determinant {determinant:.6g}"
    expect_in_words(False, name, expected, words)


def expect_all_rigid(T: Tensor, name: str, tolerance: float = RIGID) -> None:
    """The same of matrices (B, 4, 4) or (4, 4), named by their number where there are several.

    Inside transforms and on the device ``meta``, where no value can be read, nothing is checked.
    """
    if T.is_meta or transformed(T):
        return
    for b, each in enumerate(T.detach().to("cpu", torch.float64).reshape(-1, 4, 4)):
        expect_rigid(each, f"{name}[{b}]" if T.ndim == 3 and len(T) > 1 else name, tolerance)
