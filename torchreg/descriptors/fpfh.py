"""Fast Point Feature Histograms: 33 numbers of local geometry per point.

Rusu, Blodow and Beetz, ICRA 2009, doi:10.1109/ROBOT.2009.5152473; the paper's Eq. (2):

    FPFH(q) = SPFH(q) + 1/k sum_k 1/w_k SPFH(k)

SPFH(q) holds the three angles (``pair_features``) between q and each neighbor, 11 bins each, in percent; w_k is
the squared distance. As Open3D has it, the sum over neighbors is scaled to 100 per angle before SPFH(q) is
added; PCL scales it likewise and adds nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.descriptors.descriptor import Descriptor, largest_entries
from torchreg.descriptors.histograms import add_weighted_neighbors, count_votes, neighbor_votes
from torchreg.descriptors.pair_features import (
    ANGLE_BINS,
    ANGLE_EDGES,
    Oriented,
    angle_bins,
    compact_pair_features,
    pair_features,
    unit_bins,
)
from torchreg.descriptors.soft.arguments import bin_edges, expect_binning, expect_finite, slot_weights
from torchreg.descriptors.soft.fpfh import soft_fpfh
from torchreg.errors import expect_floating, one_of
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.compiled import fusible
from torchreg.geometry.numerics.gather import gather
from torchreg.native import call, native, rows
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.neighborhoods import expect_rows
from torchreg.types.precision import full_precision

FPFH_SIZE = 3 * ANGLE_BINS


@full_precision
def fpfh(
    cloud: Clouds,
    near: Neighborhoods,
    *,
    mode: str = "open3d",
    binning: str = "hard",
    bandwidth: float = 1.0,
    edges: Tensor | None = None,
    neighbor_weights: Tensor | None = None,
) -> Features:
    """FPFH of every point.

    Args:
        cloud: points and unit normals; P rows.
        near: the support of every point (the paper: 5 m, 100 nearest), the point itself counted.
        mode: ``"open3d"`` adds the point's own SPFH (a row sums to 600, a block to 200);
            ``"pcl"`` does not (300 and 100).
        binning: ``"hard"`` counts votes in bins; ``"soft"`` lets a vote pass linearly from bin to bin, over the
            ends of f1 too, which is an angle (``soft.votes``).
        bandwidth: of soft binning, in (0, 1]: the part of a bin over which a vote passes to the next one. At 1 a bin
            weighs votes by a triangle; narrow ones give the hard histogram.
        edges: of soft binning, (3, 12) ascending from 0 to 1: where the bins of f1, f2 and f3 end, as parts of
            their ranges [-pi, pi], [-1, 1], [-1, 1]; ``None`` for equal bins. Its first and last column stay 0 and 1.
        neighbor_weights: of soft binning, (P, K) not below 0, multiplied into the votes of SPFH and the weights of
            the sum over neighbors.

    Returns:
        Features of one block ("fpfh", 33): the angles f1, f2, f3, 11 bins each. A point without a neighbor
        gets a zero row and is not valid. The values are the same bits for any chunking, batch and number of
        threads (soft: on the CPU).

        No gradients flow through hard histograms. Through soft ones they flow to points, normals, edges and
        neighbor weights, of any order, finite for coincident points and parallel normals too; ``soft.pairs``
        says where the values are continuous. The neighborhood is held fixed. The backward pass computes
        pairs again, so memory stays that of one piece of rows.

    Raises:
        ValueError: no normals, shapes that do not fit, a bandwidth or edges out of their range, or options of soft
            binning with hard binning.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(points=torch.rand(50, 3))
        >>> near = tr.neighbors(cloud, radius=0.5, max_neighbors=20)
        >>> cloud = tr.estimate_normals(cloud, near)
        >>> tr.fpfh(cloud, near).values.shape
        torch.Size([50, 33])
    """
    one_of(mode, "mode", ("open3d", "pcl"))
    expect_binning(binning, bandwidth, edges=edges, neighbor_weights=neighbor_weights)
    if cloud.normals is None:
        raise ValueError("cloud: expected normals (estimate_normals gives them), got none")
    expect_floating(cloud.points, "points")
    expect_rows(near, cloud)
    expect_finite(cloud.points, "points")
    expect_finite(cloud.normals, "normals")
    if binning == "soft":
        values = soft_fpfh(
            cloud.points,
            cloud.normals,
            near,
            keep_own=mode == "open3d",
            bandwidth=bandwidth,
            edges=bin_edges(edges, 3, ANGLE_BINS, cloud.points),
            neighbor_weights=slot_weights(neighbor_weights, near, cloud.points),
        )
    else:
        spfh = simplified_histograms(cloud.points, cloud.normals, near)
        values = add_weighted_neighbors(spfh, near, ANGLE_BINS, keep_own=mode == "open3d")
    return Features(values, cloud.offsets, (("fpfh", FPFH_SIZE),), valid=largest_entries(values) != 0)


@checked_record
@dataclass(frozen=True, kw_only=True)
class Fpfh(Descriptor):
    """``torchreg.fpfh``: 33 numbers of local geometry.

    Attributes:
        mode: ``"open3d"`` or ``"pcl"``.

    Example:
        >>> import torchreg as tr
        >>> tr.Fpfh(radius=0.25).scaled(2.0)
        Fpfh(radius=0.5, max_neighbors=100, mode='open3d')
    """

    name: ClassVar[str] = "fpfh"
    is_histogram: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    mode: str = "open3d"

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of(self.mode, "mode", ("open3d", "pcl"))

    @property
    def reach(self) -> float:
        """Meters: a point reads the histograms of its neighbors, which read theirs."""
        return 2 * self.radius

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.fpfh``."""
        return fpfh(cloud, near, mode=self.mode)

    def unsigned(self, values: Tensor) -> Tensor:
        """The histograms of f1 and f3, which the sign of the normals mirrors, folded at their middle: 33 numbers."""
        f1, f2, f3 = values.split(ANGLE_BINS, dim=1)
        return torch.cat([f1 + f1.flip(1), f2, f3 + f3.flip(1)], dim=1)


def simplified_histograms(points: Tensor, normals: Tensor, near: Neighborhoods) -> Tensor:
    """SPFH (P, 33) of every point: percent of its neighbors per bin, 100 per angle."""
    if native(points, normals, near.index, near.valid) and points.dtype == normals.dtype == torch.float32:
        return _histograms_compiled(points, normals, near)
    kernel = _exact_bins if points.dtype == torch.float64 else _compact_bins
    columns = [column.contiguous() for column in (*points.detach().unbind(1), *normals.detach().unbind(1))]
    out = points.new_empty(points.shape[0], FPFH_SIZE)
    for part in row_chunks(points.shape[0], near.max_neighbors):
        votes = neighbor_votes(near.index, near.valid, part).to(torch.int32)
        index = near.index[part]
        query = Oriented(*(column[part, None] for column in columns))
        neighbor = Oriented(*(gather(column, index) for column in columns))
        counts = torch.cat([count_votes(bin_, votes, ANGLE_BINS) for bin_ in kernel(query, neighbor)], dim=1)  # (r, 33)
        total = votes.sum(dim=1, keepdim=True).clamp_(min=1).to(points.dtype)
        torch.mul(counts.to(points.dtype), 100 / total, out=out[part])
    return out


def _histograms_compiled(points: Tensor, normals: Tensor, near: Neighborhoods) -> Tensor:
    """As ``simplified_histograms``."""
    count, width = near.index.shape
    out = points.new_empty(count, FPFH_SIZE)
    columns = points.detach().contiguous(), normals.detach().contiguous(), points.new_tensor(ANGLE_EDGES)
    call("simplified_histograms", *columns, *rows(near.index), *rows(near.valid), count, width, out)
    return out


@fusible
def _exact_bins(query: Oriented, neighbor: Oriented) -> tuple[Tensor, Tensor, Tensor]:
    pair = pair_features(query, neighbor)
    return angle_bins(pair.cosine, pair.sine), unit_bins(pair.f2), unit_bins(pair.f3)


@fusible
def _compact_bins(query: Oriented, neighbor: Oriented) -> tuple[Tensor, Tensor, Tensor]:
    pair = compact_pair_features(query, neighbor)
    return angle_bins(pair.cosine, pair.sine), unit_bins(pair.f2), unit_bins(pair.f3)
