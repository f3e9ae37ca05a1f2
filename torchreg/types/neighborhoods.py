"""The neighborhood of every point as rows of an index tensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.errors import at_least, expect, expect_shape, positive
from torchreg.types.clouds import Clouds
from torchreg.types.held import Held, PerRow, held
from torchreg.types.record import Record
from torchreg.types.shown import where


@checked_record
@dataclass(frozen=True, eq=False, repr=False)
class Neighborhoods(Record):
    """Up to ``K`` neighbors of every point, ascending by (squared distance, index).

    The query point counts as its own neighbor, as in Open3D; consumers mask it out by its index, never by its place,
    since a duplicate of the point may come first.

    Attributes:
        index: (P, K) int64, global rows of the packed batch, legal to gather also where ``valid`` is false.
        valid: (P, K) bool; true slots come first.
        sq_distance: (P, K) squared meters, finite also where ``valid`` is false; consumers mask such slots.
        radius: meters, the support radius: every neighbor is nearer. A number, or one per point (P,) where they
            differ; ``None`` where it is not known.

    Example:
        >>> import torch, torchreg as tr
        >>> near = tr.neighbors(tr.Clouds(torch.rand(50, 3)), radius=0.5, max_neighbors=20)
        >>> near.index.shape, near.restrict(0.2, 5).index.shape
        (torch.Size([50, 20]), torch.Size([50, 5]))
    """

    index: Tensor = held(PerRow())
    valid: Tensor = held(PerRow())
    sq_distance: Tensor = held(PerRow(casts=True))
    radius: float | Tensor | None = held(Held(casts=True), default=None)

    def __post_init__(self) -> None:
        expect_shape(self.index, "index", ("P", "K"), torch.int64)
        shape, device = tuple(self.index.shape), self.index.device
        expect_shape(self.valid, "valid", shape, torch.bool, device)
        expect_shape(self.sq_distance, "sq_distance", shape, "floating", device)
        if self.radius is not None:
            object.__setattr__(self, "radius", self._checked_radius(self.radius))

    def __len__(self) -> int:
        """The number of points, P."""
        return self.index.shape[0]

    @property
    def max_neighbors(self) -> int:
        """The number of slots in a row, K."""
        return self.index.shape[1]

    def counts(self) -> Tensor:
        """(P,) int64: the neighbors of every point, the point itself among them."""
        return self.valid.sum(dim=1)

    def restrict(self, radius: float | Tensor | None = None, max_neighbors: int | None = None) -> Neighborhoods:
        """The smaller neighborhoods that a hybrid search with these numbers returns, without a new search.

        They are the same where the wider search had room: a row whose ``K`` slots are all taken by points nearer than
        ``radius`` stays cut off at ``K``.

        Args:
            radius: meters, a number or one per point (P,); neighbors with d^2 < radius^2 stay. The smaller of
                this one and the radius of the search becomes the new ``radius``.
            max_neighbors: the nearest so many stay, the point itself counted.

        Raises:
            ValueError: ``radius`` not above 0, or ``max_neighbors`` below 1.
        """
        width = self.max_neighbors
        if max_neighbors is not None:
            width = min(width, at_least(max_neighbors, "max_neighbors", 1))
        valid, sq_distance = self.valid[:, :width], self.sq_distance[:, :width]
        if radius is not None:
            radius = self._checked_radius(radius)
        if radius is not None and not self._reaches(radius):
            square = (
                (radius * radius)[:, None]
                if isinstance(radius, Tensor)
                else torch.as_tensor(radius**2, dtype=torch.float32)
            )
            valid = valid & (sq_distance < square.to(sq_distance))
        return Neighborhoods(self.index[:, :width], valid, sq_distance, _smaller(self.radius, radius))

    def trimmed(self) -> Neighborhoods:
        """The same neighborhoods without the slots that no row uses, after ``restrict`` most of them.

        Reads one number from the device.
        """
        return self.restrict(max_neighbors=max(1, int(self.counts().max())) if len(self) > 0 else 1)

    def of_rows(self, begin: int, end: int) -> Neighborhoods:
        """The neighborhoods of one cloud of a batch, the rows from ``begin`` to ``end``, with its own row numbers."""
        valid, radius = self.valid[begin:end], self.radius
        index = torch.where(valid, self.index[begin:end] - begin, 0)
        if isinstance(radius, Tensor):
            radius = radius[begin:end]
        return Neighborhoods(index, valid, self.sq_distance[begin:end], radius)

    def _facts(self) -> Sequence[str]:
        counts = self.counts()
        mean = float(counts.double().mean()) if len(self) > 0 else 0.0
        radius = (
            "of each point" if isinstance(self.radius, Tensor) else f"{self.radius} m" if self.radius else "not known"
        )
        return (
            f"{len(self):,} points, {mean:.1f} of at most {self.max_neighbors} neighbors each",
            f"radius {radius}",
            where(self.sq_distance),
        )

    def _reaches(self, radius: float | Tensor) -> bool:
        """Whether no neighbor is farther than ``radius``, as far as that is known without a look at them."""
        if isinstance(radius, Tensor) or isinstance(self.radius, Tensor):
            return False
        return self.radius is not None and radius >= self.radius

    def _checked_radius(self, radius: float | Tensor) -> float | Tensor:
        if not isinstance(radius, Tensor):
            return positive(radius, "radius")
        expect(radius.shape == (len(self),), "radius", f"a number or one per point ({len(self)},)", radius)
        return radius


def _smaller(one: float | Tensor | None, other: float | Tensor | None) -> float | Tensor | None:
    """The smaller of two radii, point by point."""
    if one is None or other is None:
        return other if one is None else one
    if isinstance(one, Tensor):
        return torch.minimum(one, other) if isinstance(other, Tensor) else one.clamp(max=other)
    return other.clamp(max=one) if isinstance(other, Tensor) else min(one, other)


def expect_rows(near: Neighborhoods, cloud: Clouds) -> None:
    """Check that there is one neighborhood for every point of a batch of clouds."""
    points, rows = cloud.points.shape[0], near.index.shape[0]
    if points != rows:
        raise ValueError(f"near: expected neighborhoods of {points} points, got {rows}")
