"""What ``icp`` refuses, and why a pair cannot start."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.se3 import apply_rotation
from torchreg.refinement.options import KINDS, IcpOptions
from torchreg.refinement.pairing import Pairing
from torchreg.types import Clouds

_RIGID = 1e-3  # largest entry of R R^T - I that passes for rounding
_LARGEST = 1e100  # coordinates whose squares and their sums stay finite


def expect_attributes(source: Clouds, target: Clouds, kind: str) -> None:
    """Refuse clouds without the normals or colors that a kind needs."""
    clouds = {"source": source, "target": target}
    for side, name in KINDS[kind].needs:
        expect(getattr(clouds[side], name) is not None, side, f"{name}, which kind={kind!r} needs", "none")


def broken(source: Clouds, target: Clouds, pairing: Pairing, T: Tensor, options: Sequence[IcpOptions]) -> list[str]:
    """Why every pair cannot start, empty where it can."""
    finite = torch.isfinite(T).all(dim=2).all(dim=1)
    R = T[:, :3, :3]
    square = apply_rotation(R[:, None], R)  # (B, 3, 3): R R^T, transposed
    unit = ((square - torch.eye(3, dtype=T.dtype, device=T.device)).abs() < _RIGID).all(dim=2).all(dim=1)
    last = (T[:, 3] == T.new_tensor([0.0, 0.0, 0.0, 1.0])).all(dim=1)
    flaws: dict[tuple[str, int, str], str] = {}

    def flaw(clouds: Clouds, side: str, number: int, kind: str) -> str:
        key = side, number, kind
        if key not in flaws:
            flaws[key] = _flaw(clouds, side, number, kind)
        return flaws[key]

    reasons = []
    for one, other, option, is_finite, is_rigid in zip(
        *pairing, options, finite.tolist(), (unit & last).tolist(), strict=True
    ):
        bad = flaw(source, "source", one, option.kind) or flaw(target, "target", other, option.kind)
        if not is_finite:
            bad = "the transform to start from is not finite"
        elif not is_rigid:
            bad = "the transform to start from is not rigid"
        reasons.append(bad)
    return reasons


def _flaw(clouds: Clouds, side: str, b: int, kind: str) -> str:
    begin, end = clouds.offsets[b : b + 2].tolist()
    if begin == end:
        return f"the {side} is empty"
    needed = {"points": clouds.points[begin:end], "origin": clouds.origin[b]}
    needed |= {name: getattr(clouds, name)[begin:end] for of_side, name in KINDS[kind].needs if of_side == side}
    for name, values in needed.items():
        if not bool((values.abs() < _LARGEST).all()):
            return f"the {side} has {name} that are not finite"
    return ""
