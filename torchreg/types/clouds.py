"""A packed batch of point clouds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape
from torchreg.types.packing import checked_offsets, offsets_of, spans


@dataclass(frozen=True, eq=False)
class Clouds:
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

    points: Tensor
    offsets: Tensor = None  # type: ignore[assignment]  # filled in below: one cloud of all rows
    colors: Tensor | None = None
    normals: Tensor | None = None
    origin: Tensor = None  # type: ignore[assignment]  # filled in below: zeros
    viewpoint: Tensor | None = None
    viewpoint_assumed: Tensor = None  # type: ignore[assignment]  # filled in below: no viewpoint is a guess

    def __post_init__(self) -> None:
        expect_shape(self.points, "points", ("P", 3), "floating")
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
    def pack(clouds: Sequence[Clouds]) -> Clouds:
        """Join batches of clouds into one; usable as the ``collate_fn`` of a ``DataLoader``.

        Colors and normals must be there for all clouds or for none. A cloud without a viewpoint gets NaN
        when others have one.

        Raises:
            ValueError: nothing to pack, or some clouds have colors (normals) and others have none.
        """
        clouds = list(clouds)
        expect(len(clouds) > 0, "clouds", "at least one cloud", clouds)
        viewpoint = None
        if any(cloud.viewpoint is not None for cloud in clouds):
            viewpoint = torch.cat([_viewpoint_or_nan(cloud) for cloud in clouds])
        return Clouds(
            points=torch.cat([cloud.points for cloud in clouds]),
            offsets=offsets_of(length for cloud in clouds for length in cloud.lengths),
            colors=_cat_all_or_none("colors", [cloud.colors for cloud in clouds]),
            normals=_cat_all_or_none("normals", [cloud.normals for cloud in clouds]),
            origin=torch.cat([cloud.origin for cloud in clouds]),
            viewpoint=viewpoint,
            viewpoint_assumed=torch.cat([cloud.viewpoint_assumed for cloud in clouds]),
        )

    def unpack(self) -> list[Clouds]:
        """The clouds as batches of one; their tensors are views."""
        return [
            Clouds(
                points=self.points[begin:end],
                colors=None if self.colors is None else self.colors[begin:end],
                normals=None if self.normals is None else self.normals[begin:end],
                origin=self.origin[b : b + 1],
                viewpoint=None if self.viewpoint is None else self.viewpoint[b : b + 1],
                viewpoint_assumed=self.viewpoint_assumed[b : b + 1],
            )
            for b, (begin, end) in enumerate(spans(self.offsets))
        ]

    def select(self, which: int | Sequence[int]) -> Clouds:
        """The batch of these clouds, in this order; a cloud may be named several times.

        Raises:
            IndexError: a number outside [-B, B).
        """
        single = self.unpack()
        chosen = [single[which]] if isinstance(which, int) else [single[b] for b in which]
        return chosen[0] if len(chosen) == 1 else Clouds.pack(chosen)

    def rows(self, index: Tensor, offsets: Tensor) -> Clouds:
        """The clouds made of the rows ``index`` (Q,) of this batch, split by ``offsets`` (B+1,)."""
        return replace(
            self,
            points=self.points[index],
            offsets=offsets,
            colors=None if self.colors is None else self.colors[index],
            normals=None if self.normals is None else self.normals[index],
        )

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Clouds:
        """Copy to a device or change the dtype of points, colors, normals and viewpoint (``origin`` stays float64)."""
        return self._mapped(lambda value: value.to(device=device, dtype=dtype), lambda value: value.to(device=device))

    def detach(self) -> Clouds:
        """The same tensors, without gradients."""
        return self._mapped(Tensor.detach, Tensor.detach)

    def pin_memory(self) -> Clouds:
        """Copy into page-locked memory, for faster and asynchronous transfer to a GPU."""
        return self._mapped(Tensor.pin_memory, Tensor.pin_memory)

    def _has_viewpoint(self) -> Tensor:
        """Whether each cloud has a viewpoint, known or assumed: (B,) bool."""
        if self.viewpoint is None:
            return torch.zeros(len(self), dtype=torch.bool, device=self.device)
        return self.viewpoint.isfinite().all(dim=1)

    def _mapped(self, change: Callable[[Tensor], Tensor], move: Callable[[Tensor], Tensor]) -> Clouds:
        """The clouds with every tensor of the points' dtype changed by one function, the others moved by another."""

        def optional(value: Tensor | None) -> Tensor | None:
            return None if value is None else change(value)

        return Clouds(
            points=change(self.points),
            offsets=self.offsets,
            colors=optional(self.colors),
            normals=optional(self.normals),
            origin=move(self.origin),
            viewpoint=optional(self.viewpoint),
            viewpoint_assumed=move(self.viewpoint_assumed),
        )


def _viewpoint_or_nan(cloud: Clouds) -> Tensor:
    if cloud.viewpoint is not None:
        return cloud.viewpoint
    return cloud.points.new_full((len(cloud), 3), float("nan"))


def _cat_all_or_none(name: str, parts: list[Tensor | None]) -> Tensor | None:
    present = [part for part in parts if part is not None]
    expect(
        len(present) in (0, len(parts)),
        name,
        f"{name} for all {len(parts)} clouds or for none",
        f"{len(present)} with and {len(parts) - len(present)} without",
    )
    return torch.cat(present) if present else None
