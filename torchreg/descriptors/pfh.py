"""Point Feature Histograms: the three angles between all pairs of neighbors, 125 numbers per point.

Rusu, Blodow, Marton and Beetz, IROS 2008, doi:10.1109/IROS.2008.4650967, as PCL has it:

    PFH(q)[f1, f2, f3] = 100 x (pairs of neighbors of q in that cell) / (n (n - 1) / 2)

with n neighbors, q among them, and five bins per angle (``pair_features``), f1 moving fastest. FPFH, which came later,
counts the pairs with q alone, keeps the three angles apart, and so costs a K-th of it.

A pair whose angles are not defined, of points in one place or with the line along the first normal, counts with three
zeros. So every histogram sums to 100.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.descriptors.descriptor import Descriptor, largest_entries
from torchreg.descriptors.histograms import count_votes
from torchreg.descriptors.neighbor_pairs import (
    PAIR_BINS,
    PAIR_CELLS,
    PAIR_EDGES,
    pair_cells,
    pair_pieces,
    pair_share,
    used_slots,
)
from torchreg.descriptors.pair_features import Oriented, angle_bins, compact_pair_features, unit_bins
from torchreg.descriptors.soft.arguments import expect_binning, expect_finite
from torchreg.descriptors.soft.pfh import soft_pfh
from torchreg.errors import expect_floating
from torchreg.geometry.numerics.compiled import fusible
from torchreg.native import call, native, rows
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.neighborhoods import expect_rows
from torchreg.types.precision import full_precision

PFH_SIZE = PAIR_CELLS


@full_precision
def pfh(cloud: Clouds, near: Neighborhoods, *, binning: str = "hard", bandwidth: float = 1.0) -> Features:
    """PFH of every point.

    Args:
        cloud: points and unit normals; P rows.
        near: the support of every point, the point itself counted. Work grows with the square of its neighbors.
        binning: ``"hard"`` counts pairs in cells; ``"soft"`` lets a pair pass linearly from cell to cell, over the ends
            of f1 too, which is an angle (``soft.votes``).
        bandwidth: of soft binning, in (0, 1]: the part of a bin over which a vote passes to the next one.

    Returns:
        Features of one block ("pfh", 125). A point without neighbors gets a zero row and is not valid. The same bits
        for any chunking, batch and number of threads (soft: on the CPU). With PCL's normals and neighborhoods the
        values are PCL's within rounding, but for pairs that rounding moves over the edge of a bin.

        No gradients flow through hard histograms. Through soft ones they flow to points and normals, of any order,
        finite for coincident points and parallel normals too; ``soft.pairs`` says where the values are continuous.
        The neighborhood is held fixed.

    Raises:
        ValueError: no normals, shapes that do not fit, numbers that are not finite, or a bandwidth out of its range or
            with hard binning.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(points=torch.rand(50, 3))
        >>> near = tr.neighbors(cloud, radius=0.5, max_neighbors=20)
        >>> cloud = tr.estimate_normals(cloud, near)
        >>> tr.pfh(cloud, near).values.shape
        torch.Size([50, 125])
    """
    expect_binning(binning, bandwidth, edges=None, neighbor_weights=None)
    normals = expect_oriented(cloud, near)
    if binning == "soft":
        values = soft_pfh(cloud.points, normals, near, bandwidth)
    else:
        values = pair_histograms(cloud.points, normals, near)
    return Features(values, cloud.offsets, (("pfh", PFH_SIZE),), valid=largest_entries(values) != 0)


@checked_record
@dataclass(frozen=True, kw_only=True)
class Pfh(Descriptor):
    """``torchreg.pfh``: 125 numbers of local geometry, from all pairs of neighbors.

    Example:
        >>> import torchreg as tr
        >>> options = tr.RegistrationOptions(descriptors=(tr.Pfh(radius=0.3),), weights=(1.0,))
        >>> options.scaled(2.0).descriptors[0].radius
        0.6
    """

    name: ClassVar[str] = "pfh"
    is_histogram: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    @property
    def reach(self) -> float:
        """Meters: a point reads its neighbors alone."""
        return self.radius

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.pfh``."""
        return pfh(cloud, near)

    def unsigned(self, values: Tensor) -> Tensor:
        """Each cell and the one where f1 and f3 have the other sign, which the sign of the normals exchanges, added."""
        return with_mirrored_angles(values)


def with_mirrored_angles(histograms: Tensor) -> Tensor:
    """Histograms (P, 125) plus those of the same normals with the other sign: f1 and f3 mirrored."""
    cells = histograms.view(len(histograms), PAIR_BINS, PAIR_BINS, PAIR_BINS)  # f3, f2, f1
    return (cells + cells.flip(1, 3)).view(histograms.shape)


def expect_oriented(cloud: Clouds, near: Neighborhoods) -> Tensor:
    """The normals of a cloud with one neighborhood per point, all of whose numbers are finite; else ``ValueError``."""
    if cloud.normals is None:
        raise ValueError("cloud: expected normals (estimate_normals gives them), got none")
    expect_floating(cloud.points, "points")
    expect_rows(near, cloud)
    expect_finite(cloud.points, "points")
    expect_finite(cloud.normals, "normals")
    return cloud.normals


def pair_histograms(points: Tensor, normals: Tensor, near: Neighborhoods) -> Tensor:
    """(P, 125) percent of the pairs of neighbors in each cell, by integer counts."""
    if native(points, normals, near.index, near.valid) and points.dtype == normals.dtype == torch.float32:
        return _histograms_compiled(points, normals, near)
    near = used_slots(near)
    columns = [column.contiguous() for column in (*points.detach().unbind(1), *normals.detach().unbind(1))]
    counts = torch.zeros(len(points), PFH_SIZE, dtype=torch.int32, device=points.device)
    for piece in pair_pieces(near, columns):
        cell = _cells(Oriented(*piece.first), Oriented(*piece.second))
        counts[piece.rows] += count_votes(cell, piece.valid.to(torch.int32), PFH_SIZE)
    return counts.to(points.dtype).mul_(pair_share(near.valid, points.dtype))


@fusible
def _cells(first: Oriented, second: Oriented) -> Tensor:
    pair = compact_pair_features(first, second)
    bins = angle_bins(pair.cosine, pair.sine, PAIR_EDGES), unit_bins(pair.f2, PAIR_BINS), unit_bins(pair.f3, PAIR_BINS)
    return pair_cells(bins)


def _histograms_compiled(points: Tensor, normals: Tensor, near: Neighborhoods) -> Tensor:
    """As ``pair_histograms``."""
    count, width = near.index.shape
    out = points.new_empty(count, PFH_SIZE)
    columns = points.detach().contiguous(), normals.detach().contiguous(), points.new_tensor(PAIR_EDGES)
    call("pair_histograms", *columns, *rows(near.index), *rows(near.valid), count, width, out)
    return out
