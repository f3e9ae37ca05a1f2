"""A packed batch of point clouds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape
from torchreg.types.held import Offsets, PerItem, PerRow, held
from torchreg.types.packing import checked_offsets, spans
from torchreg.types.record import PackedBatch
from torchreg.types.shown import counted, listed, where


@dataclass(frozen=True, eq=False, repr=False)
class Clouds(PackedBatch):
    """``B`` point clouds, packed: the rows of all clouds one after another. One cloud is a batch of one.

    Attributes:
        points: (P, 3) floating point, meters, relative to the origin of their cloud.
        offsets: (B+1,) int64, on the CPU; cloud ``b`` holds the rows ``offsets[b]:offsets[b+1]``.
            ``None`` at construction makes one cloud of all rows.
        colors: (P, 3) sRGB in [0, 1], or ``None``.
        normals: (P, 3) of unit length, or ``None``.
        origin: (B, 3) float64, meters: where the points' zero lies in the frame of the file. It is kept
            apart so that coordinates of UTM size lose nothing in float32; transforms include it.
            ``None`` at construction means zeros.
        viewpoint: (B, 3) scanner position in the frame of ``points`` (relative to ``origin``), or ``None``
            where there is none. A row of NaN marks one cloud of a batch without one.
        viewpoint_assumed: (B,) bool, on the device of the points: whether ``viewpoint`` is only a guess, as the
            zero of a plain file's frame is; always false for a cloud without a viewpoint. ``None`` at construction
            means that no viewpoint is a guess. A guess turns normals; it is no evidence for or against a pose. It
            stays a guess where ``dataclasses.replace`` moves it: where the scanner's position is learned later,
            ``replace(clouds, viewpoint=position, viewpoint_assumed=None)`` says so.

    Raises:
        ValueError: a tensor has another shape, dtype or device than stated here.
    """

    noun: ClassVar[str] = "clouds"

    points: Tensor = held(PerRow(casts=True))
    offsets: Tensor = held(Offsets(), default=None)  # filled in below: one cloud of all rows
    colors: Tensor | None = held(PerRow(casts=True), default=None)
    normals: Tensor | None = held(PerRow(casts=True), default=None)
    origin: Tensor = held(PerItem(), default=None)  # filled in below: zeros
    viewpoint: Tensor | None = held(PerItem(casts=True, gap=float("nan")), default=None)
    viewpoint_assumed: Tensor = held(PerItem(), default=None)  # filled in below: no viewpoint is a guess

    def __post_init__(self) -> None:
        expect_shape(self.points, "points", ("P", 3), "floating")
        rows, device = self.points.shape[0], self.points.device
        offsets = torch.tensor([0, rows]) if self.offsets is None else self.offsets
        object.__setattr__(self, "offsets", checked_offsets(offsets, rows))
        for name, value in (("colors", self.colors), ("normals", self.normals)):
            if value is not None:
                expect_shape(value, name, (rows, 3), device=device)
                expect(value.dtype == self.points.dtype, name, f"the dtype of points, {self.points.dtype}", value)
        if self.origin is None:
            object.__setattr__(self, "origin", torch.zeros(len(self), 3, dtype=torch.float64, device=device))
        expect_shape(self.origin, "origin", (len(self), 3), torch.float64, device)
        if self.viewpoint is not None:
            expect_shape(self.viewpoint, "viewpoint", (len(self), 3), "floating", device)
        if self.viewpoint_assumed is None:
            object.__setattr__(self, "viewpoint_assumed", torch.zeros(len(self), dtype=torch.bool, device=device))
        expect_shape(self.viewpoint_assumed, "viewpoint_assumed", (len(self),), torch.bool, device)
        object.__setattr__(self, "viewpoint_assumed", self.viewpoint_assumed & self._has_viewpoint())

    def __len__(self) -> int:
        """The number of clouds, B."""
        return len(self.offsets) - 1

    @property
    def lengths(self) -> list[int]:
        """The number of points of every cloud."""
        return [end - begin for begin, end in spans(self.offsets)]

    @property
    def device(self) -> torch.device:
        """Where the points are."""
        return self.points.device

    @property
    def viewpoint_known(self) -> Tensor:
        """Whether the position of each scanner is known, (B,) bool: there is a viewpoint, and it is not a guess."""
        return self._has_viewpoint() & ~self.viewpoint_assumed

    def unpack(self) -> list[Clouds]:
        """The clouds as batches of one; their tensors are views."""
        return list(self)

    def select(self, which: int | Sequence[int]) -> Clouds:
        """The batch of these clouds, in this order; a cloud may be named several times. As ``clouds[which]``.

        Raises:
            IndexError: a number outside [-B, B).
        """
        return self[which]

    def rows(self, index: Tensor, offsets: Tensor) -> Clouds:
        """The clouds made of the rows ``index`` (Q,) of this batch, split by ``offsets`` (B+1,)."""
        return replace(
            self,
            points=self.points[index],
            offsets=offsets,
            colors=None if self.colors is None else self.colors[index],
            normals=None if self.normals is None else self.normals[index],
        )

    def _facts(self) -> Sequence[str]:
        kept = [name for name in ("colors", "normals") if getattr(self, name) is not None]
        if self.viewpoint is not None:
            known = self.viewpoint_known.tolist()
            kept.append("viewpoints known: " + listed(known))
        far = self.origin.abs().max(dim=0).values.tolist() if len(self) else []
        kept += ["origins far from zero"] if any(far) else []
        return (
            f"{len(self)} {self.noun if len(self) != 1 else 'cloud'} of {counted(self.lengths)} points",
            ", ".join(kept) or "no colors, no normals, no viewpoint",
            where(self.points),
        )

    def _has_viewpoint(self) -> Tensor:
        """Whether each cloud has a viewpoint, known or assumed: (B,) bool."""
        if self.viewpoint is None:
            return torch.zeros(len(self), dtype=torch.bool, device=self.device)
        return self.viewpoint.isfinite().all(dim=1)
