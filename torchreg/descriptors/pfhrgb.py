"""PFH with colors: the angles and the color ratios of all pairs of neighbors, 250 numbers per point.

PCL's PFHRGBEstimation is the reference; there is no paper of its own. A pair counts twice, once with either of its
points first, and points do not exchange their places as in PFH. The first 125 numbers are cells of the three angles,
the others cells of the ratios of red, green and blue, each made a number in [-1, 1]:

    ratio = c1 / c2 where c1 <= c2,   -c2 / c1 where c1 > c2,   1 where c2 = 0

in five equal bins. Both halves are percent of n (n - 1) / 2, half as many as there are votes: each sums to 200.

Where two points lie in one place or the line along the first normal, the angles count as zeros, as in PCL. There PCL
counts the color ratios of the pair that it saw before (they are left as they were); here they are those of the pair.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.descriptors.color import colors_of
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
from torchreg.descriptors.pfh import expect_oriented, with_mirrored_angles
from torchreg.descriptors.soft.arguments import expect_binning
from torchreg.descriptors.soft.pfh import soft_pfhrgb
from torchreg.geometry.numerics.compiled import fusible
from torchreg.native import call, native, rows
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.precision import full_precision

PFHRGB_SIZE = 2 * PAIR_CELLS

RATIO_EDGES = (-0.6 + 1e-6, -0.2 - 1e-6, 0.2 - 1e-6, 0.6 - 1e-6)
"""Where the inner bins of color ratios begin. Ratios of 8-bit colors meet the edges often, as 3 : 5, and are rounded:
each edge is moved a little, so that all of these fall on the side on which PCL's arithmetic has them."""


@full_precision
def pfhrgb(cloud: Clouds, near: Neighborhoods, *, binning: str = "hard", bandwidth: float = 1.0) -> Features:
    """PFHRGB of every point.

    Args:
        cloud: points, unit normals and colors; P rows.
        near: the support of every point, the point itself counted. Work grows with the square of its neighbors.
        binning, bandwidth: as in ``pfh``.

    Returns:
        Features of one block ("pfhrgb", 250): angles (125), color ratios (125). A point without neighbors gets a zero
        row and is not valid. The same bits for any chunking, batch and number of threads (soft: on the CPU). With
        PCL's normals, neighborhoods and 8-bit colors the values are PCL's within rounding, but for pairs that rounding
        moves over the edge of a bin of an angle.

        No gradients flow through hard histograms. Through soft ones they flow to points, normals and colors; where two
        colors are equal the ratio jumps from 1 to -1, as a hard one does.

    Raises:
        ValueError: no normals or colors, shapes that do not fit, numbers that are not finite, or a bandwidth out of its
            range or with hard binning.

    Example:
        >>> import torchreg as tr
        >>> cloud = tr.datasets.mall(seed=1, angular_step=3.0).source
        >>> near = tr.neighbors(cloud, 2.0, 60)
        >>> cloud = tr.estimate_normals(cloud, near)
        >>> tr.pfhrgb(cloud, near).values.shape[1]
        250
    """
    expect_binning(binning, bandwidth, edges=None, neighbor_weights=None)
    normals = expect_oriented(cloud, near)
    colors = colors_of(cloud)
    if binning == "soft":
        values = soft_pfhrgb(cloud.points, normals, colors, near, bandwidth)
    else:
        values = colored_pair_histograms(cloud.points, normals, colors, near)
    return Features(values, cloud.offsets, (("pfhrgb", PFHRGB_SIZE),), valid=largest_entries(values) != 0)


@checked_record
@dataclass(frozen=True, kw_only=True)
class PfhRgb(Descriptor):
    """``torchreg.pfhrgb``: 250 numbers of geometry and color, from all pairs of neighbors.

    Example:
        >>> import torchreg as tr
        >>> options = tr.RegistrationOptions(descriptors=(tr.PfhRgb(radius=0.3),), weights=(1.0,))
        >>> options.scaled(2.0).descriptors[0].radius
        0.6
    """

    name: ClassVar[str] = "pfhrgb"
    needs_colors: ClassVar[bool] = True
    is_histogram: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    @property
    def reach(self) -> float:
        """Meters: a point reads its neighbors alone."""
        return self.radius

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.pfhrgb``."""
        return pfhrgb(cloud, near)

    def unsigned(self, values: Tensor) -> Tensor:
        """The angles folded as those of ``Pfh``, and the color ratios as they are."""
        return torch.cat([with_mirrored_angles(values[:, :PAIR_CELLS]), values[:, PAIR_CELLS:]], dim=1)


def colored_pair_histograms(points: Tensor, normals: Tensor, colors: Tensor, near: Neighborhoods) -> Tensor:
    """(P, 250) percent of ordered pairs of neighbors in each cell of angles and of color ratios, by integer counts."""
    single = points.dtype == normals.dtype == colors.dtype == torch.float32
    if native(points, normals, colors, near.index, near.valid) and single:
        return _histograms_compiled(points, normals, colors, near)
    near = used_slots(near)
    columns = [column.contiguous() for part in (points, normals, colors) for column in part.detach().unbind(1)]
    counts = torch.zeros(len(points), PFHRGB_SIZE, dtype=torch.int32, device=points.device)
    for piece in pair_pieces(near, columns):
        for first, second in ((piece.first, piece.second), (piece.second, piece.first)):
            cells = torch.cat(_cells(first, second), dim=1)
            counts[piece.rows] += count_votes(cells, piece.valid.to(torch.int32).repeat(1, 2), PFHRGB_SIZE)
    return counts.to(points.dtype).mul_(pair_share(near.valid, points.dtype))


@fusible
def _cells(first: tuple[Tensor, ...], second: tuple[Tensor, ...]) -> tuple[Tensor, Tensor]:
    """The cells of angles and of color ratios of pairs whose points keep their places."""
    pair = compact_pair_features(Oriented(*first[:6]), Oriented(*second[:6]), exchange=False)
    bins = angle_bins(pair.cosine, pair.sine, PAIR_EDGES), unit_bins(pair.f2, PAIR_BINS), unit_bins(pair.f3, PAIR_BINS)
    red, green, blue = (_ratio_bins(one, other) for one, other in zip(first[6:], second[6:], strict=True))
    return pair_cells(bins), pair_cells((red, green, blue)) + PAIR_CELLS


def _ratio_bins(first: Tensor, second: Tensor) -> Tensor:
    """Bin 0..4 (int64) of the ratio of two colors."""
    black = second == 0
    quotient = torch.where(black, 1, first / torch.where(black, 1, second))
    ratio = torch.where(quotient > 1, -1 / quotient, quotient)
    passed = torch.zeros_like(first, dtype=torch.int64)
    for edge in RATIO_EDGES:
        passed += ratio >= edge
    return passed


def _histograms_compiled(points: Tensor, normals: Tensor, colors: Tensor, near: Neighborhoods) -> Tensor:
    """As ``colored_pair_histograms``."""
    count, width = near.index.shape
    out = points.new_empty(count, PFHRGB_SIZE)
    columns = (part.detach().contiguous() for part in (points, normals, colors))
    edges = points.new_tensor(PAIR_EDGES), points.new_tensor(RATIO_EDGES)
    call("colored_pair_histograms", *columns, *edges, *rows(near.index), *rows(near.valid), count, width, out)
    return out
