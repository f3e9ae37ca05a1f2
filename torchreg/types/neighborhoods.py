"""The neighborhood of every point as rows of an index tensor."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.errors import at_least, expect, expect_device, expect_dtype, expect_floating, expect_shape, positive


@dataclass(frozen=True, eq=False)
class Neighborhoods:
    """Up to ``K`` neighbors of every point, ascending by (squared distance, index).

    The query point counts as its own neighbor, as in Open3D; consumers mask it out by its index, never by
    its place, since a duplicate of the point may come first.

    Attributes:
        index: (P, K) int64, global rows of the packed batch, legal to gather also where ``valid`` is false.
        valid: (P, K) bool; true slots come first.
        sq_distance: (P, K) squared meters, finite also where ``valid`` is false. What stands in such slots
            means nothing; consumers mask it.
    """

    index: Tensor
    valid: Tensor
    sq_distance: Tensor

    def __post_init__(self) -> None:
        expect_shape(self.index, "index", ("P", "K"))
        expect_dtype(self.index, "index", torch.int64)
        rows, width = self.index.shape
        expect_shape(self.valid, "valid", (rows, width))
        expect_dtype(self.valid, "valid", torch.bool)
        expect_shape(self.sq_distance, "sq_distance", (rows, width))
        expect_floating(self.sq_distance, "sq_distance")
        expect_device(self.valid, "valid", self.index.device)
        expect_device(self.sq_distance, "sq_distance", self.index.device)

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
        """A smaller neighborhood without a new search: what a hybrid search with these numbers returns.

        That holds as long as the wider search had room: a row whose ``K`` slots are all taken by points
        nearer than ``radius`` stays cut off at ``K``.

        Args:
            radius: meters, a number or one per point (P,); neighbors with d^2 < radius^2 stay.
            max_neighbors: the nearest so many stay, the point itself counted.

        Raises:
            ValueError: ``radius`` not above 0, or ``max_neighbors`` below 1.
        """
        width = self.max_neighbors
        if max_neighbors is not None:
            width = min(width, at_least(max_neighbors, "max_neighbors", 1))
        index, valid, sq_distance = self.index[:, :width], self.valid[:, :width], self.sq_distance[:, :width]
        if radius is not None:
            if isinstance(radius, Tensor):
                expect(radius.shape == (len(self),), "radius", f"a number or one per point ({len(self)},)", radius)
                limit = (radius * radius)[:, None].to(sq_distance)
            else:
                limit = torch.as_tensor(positive(radius, "radius") ** 2).to(sq_distance)
            valid = valid & (sq_distance < limit)
        return Neighborhoods(index, valid, sq_distance)

    def trimmed(self) -> Neighborhoods:
        """The same neighborhoods without the slots that no row uses, after ``restrict`` most of them.

        Reads one number from the device.
        """
        width = max(1, int(self.counts().max())) if len(self) > 0 else 1
        return Neighborhoods(self.index[:, :width], self.valid[:, :width], self.sq_distance[:, :width])
