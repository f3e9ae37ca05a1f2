"""What ``icp`` refuses, and why a pair cannot begin."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.se3 import apply_rotation
from torchreg.refinement.options import IcpOptions
from torchreg.types import Clouds
from torchreg.types.packing import spans

_RIGID = 1e-3  # largest entry of R R^T - I that passes for rounding
_LARGEST = 1e100  # coordinates whose squares and their sums stay finite


def per_pair(options: IcpOptions | Sequence[IcpOptions] | None, pairs: int) -> list[IcpOptions]:
    """The options of every pair."""
    if options is None or isinstance(options, IcpOptions):
        return [options or IcpOptions()] * pairs
    expect(isinstance(options, Sequence), "options", "IcpOptions or a sequence of them", options)
    listed = list(options)
    expect(len(listed) == pairs, "options", f"one, or one per pair ({pairs})", len(listed))
    for option in listed:
        expect(isinstance(option, IcpOptions), "options", "IcpOptions or a sequence of them", option)
    return listed


def expect_attributes(source: Clouds, target: Clouds, kind: str) -> None:
    """Refuse clouds without the normals and colors that a kind needs."""
    if kind != "point_to_point":
        expect(target.normals is not None, "target", f"normals, which kind={kind!r} needs", "none")
    if kind == "colored":
        expect(source.colors is not None, "source", f"colors, which kind={kind!r} needs", "none")
        expect(target.colors is not None, "target", f"colors, which kind={kind!r} needs", "none")


def broken(source: Clouds, target: Clouds, T: Tensor, options: Sequence[IcpOptions]) -> list[str]:
    """Why a pair cannot begin, empty where it can."""
    finite = torch.isfinite(T).all(dim=2).all(dim=1)
    R = T[:, :3, :3]
    square = apply_rotation(R[:, None], R)  # (B, 3, 3): R R^T, transposed
    unit = ((square - torch.eye(3, dtype=T.dtype, device=T.device)).abs() < _RIGID).all(dim=2).all(dim=1)
    last = (T[:, 3] == T.new_tensor([0.0, 0.0, 0.0, 1.0])).all(dim=1)
    reasons = []
    for b, (one, other) in enumerate(zip(spans(source.offsets), spans(target.offsets), strict=True)):
        bad = _flaw(source, *one, "source", b, options[b].kind) or _flaw(target, *other, "target", b, options[b].kind)
        if not bool(finite[b]):
            bad = "the transform to start from is not finite"
        elif not bool(unit[b] & last[b]):
            bad = "the transform to start from is not rigid"
        reasons.append(bad)
    return reasons


def _flaw(clouds: Clouds, begin: int, end: int, side: str, b: int, kind: str) -> str:
    if begin == end:
        return f"the {side} is empty"
    needed = {"points": clouds.points[begin:end], "origin": clouds.origin[b]}
    if kind != "point_to_point" and side == "target" and clouds.normals is not None:
        needed["normals"] = clouds.normals[begin:end]
    if kind == "colored" and clouds.colors is not None:
        needed["colors"] = clouds.colors[begin:end]
    for name, values in needed.items():
        if not bool((values.abs() < _LARGEST).all()):
            return f"the {side} has {name} that are not finite"
    return ""
