"""A packed batch of point clouds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from torchreg.errors import ArgumentTypeError, described_with_type, expect, expect_shape
from torchreg.types.held import Offsets, PerItem, PerRow, held
from torchreg.types.packing import checked_offsets, offsets_of, spans
from torchreg.types.padded import PaddedClouds, checked_lengths, pad, unpad
from torchreg.types.record import PackedBatch
from torchreg.types.shown import counted, listed, several, where


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

    Example:
        >>> import torch, torchreg as tr
        >>> clouds = tr.Clouds.pack([tr.Clouds(torch.rand(5, 3)), tr.Clouds(torch.rand(2, 3))])
        >>> len(clouds), clouds.lengths, clouds[1].points.shape
        (2, [5, 2], torch.Size([2, 3]))
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
        _expect_points(self.points)
        rows, device = self.points.shape[0], self.points.device
        offsets = torch.tensor([0, rows], device="cpu") if self.offsets is None else self.offsets
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
        return [end - begin for begin, end in spans(self.offsets, self.points.shape[0])]

    @property
    def device(self) -> torch.device:
        """Where the points are."""
        return self.points.device

    @property
    def viewpoint_known(self) -> Tensor:
        """Whether the position of each scanner is known, (B,) bool: there is a viewpoint, and it is not a guess."""
        return self._has_viewpoint() & ~self.viewpoint_assumed

    @staticmethod
    def from_list(
        points: Sequence[Tensor],
        colors: Sequence[Tensor] | None = None,
        normals: Sequence[Tensor] | None = None,
    ) -> Clouds:
        """Make a batch of the points of B clouds, each (P_b, 3), at the origin zero; gradients flow.

        Args:
            points: meters, one tensor per cloud, of one dtype and device.
            colors: sRGB in [0, 1], one (P_b, 3) per cloud.
            normals: of unit length, likewise.

        Raises:
            ValueError: no cloud, a tensor of another shape, dtype or device, or other numbers of rows than of points.

        Example:
            >>> Clouds.from_list([torch.rand(5, 3), torch.rand(2, 3)]).lengths
            [5, 2]
        """
        points = list(points)
        expect(len(points) > 0, "points", "at least one tensor (P, 3)", points)
        expect_shape(points[0], "points[0]", ("P", 3), "floating")
        return Clouds(
            points=_cat_like("points", points, points),
            offsets=offsets_of(map(len, points)),
            colors=None if colors is None else _cat_like("colors", colors, points),
            normals=None if normals is None else _cat_like("normals", normals, points),
        )

    @staticmethod
    def from_padded(
        points: Tensor,
        lengths: Tensor | Sequence[int],
        colors: Tensor | None = None,
        normals: Tensor | None = None,
    ) -> Clouds:
        """Make a batch of padded points (B, N, 3), of which cloud b has the first ``lengths[b]``; gradients flow.

        Args:
            points: meters; rows behind are ignored, whatever they hold.
            lengths: B whole numbers from 0 to N, a tensor (B,) or a sequence.
            colors: (B, N, 3) sRGB in [0, 1].
            normals: (B, N, 3) of unit length.

        Raises:
            ValueError: shapes that differ, or lengths without room.

        Example:
            >>> Clouds.from_padded(torch.rand(2, 7, 3), [7, 4]).lengths
            [7, 4]
        """
        offsets = checked_lengths(lengths, points)
        for name, values in (("colors", colors), ("normals", normals)):
            if values is not None:
                expect_shape(values, name, tuple(points.shape), points.dtype, points.device)
        return Clouds(
            points=unpad(points, offsets),
            offsets=offsets,
            colors=None if colors is None else unpad(colors, offsets),
            normals=None if normals is None else unpad(normals, offsets),
        )

    def to_padded(self) -> PaddedClouds:
        """Points, colors and normals as (B, N, 3), zero behind the last row of each cloud; gradients flow."""
        more = (None if rows is None else pad(rows, self.offsets) for rows in (self.colors, self.normals))
        return PaddedClouds(pad(self.points, self.offsets), self.offsets.diff().to(self.device), *more)

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
            f"{several(len(self), self.noun)} of {counted(self.lengths)} points",
            ", ".join(kept) or "no colors, no normals, no viewpoint",
            where(self.points),
        )

    @staticmethod
    def _made_of(value: object) -> str:
        """How clouds are made of what came in their place, for messages."""
        return next((text for kind, text in _MADE_OF if isinstance(value, kind)), "read_cloud(path)")

    def _has_viewpoint(self) -> Tensor:
        """Whether each cloud has a viewpoint, known or assumed: (B,) bool."""
        if self.viewpoint is None:
            return torch.zeros(len(self), dtype=torch.bool, device=self.device)
        return self.viewpoint.isfinite().all(dim=1)


_MADE_OF: tuple[tuple[Any, str], ...] = (
    (Tensor, "Clouds(points) of points (P, 3) in meters"),
    (np.ndarray, "torchreg.from_numpy(points) of points (P, 3) in meters"),
    ((list, tuple), "Clouds.from_list(points) of tensors (P, 3) in meters"),
)
"""How clouds are made of what may come in their place."""


def _expect_points(points: object) -> None:
    """Check the points of clouds; the message about an array, a list or padded points says what takes these."""
    if not isinstance(points, Tensor):
        takes = Clouds._made_of(points)
        raise ArgumentTypeError(f"points: expected a tensor (P, 3), got {described_with_type(points)}; try {takes}")
    if points.ndim == 3:
        shape = tuple(points.shape)
        raise ValueError(f"points: expected (P, 3), got {shape}; try Clouds.from_padded(points, lengths) of (B, N, 3)")
    expect_shape(points, "points", ("P", 3), "floating")


def _cat_like(name: str, values: Sequence[Tensor], points: Sequence[Tensor]) -> Tensor:
    """The rows of all clouds, as many as points of each, of the dtype and device of the first points."""
    expect(len(values) == len(points), name, f"one tensor per cloud ({len(points)})", len(values))
    first = points[0]
    for b, (value, rows) in enumerate(zip(values, points, strict=True)):
        expect_shape(value, f"{name}[{b}]", ("P" if value is rows else len(rows), 3), first.dtype, first.device)
    return torch.cat(list(values))
