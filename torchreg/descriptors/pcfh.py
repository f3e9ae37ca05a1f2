"""Point Color Feature Histograms: how the colors around a point differ from its own (the paper, section 3.4).

    HHD(q)  = Histogram(|h_q - h_k|, d)                     Eq. (3)
    PCFH(q) = HHD(q) + 1/k sum_k 1/w_k HHD(k)               Eq. (4)

Hue is a circle: the difference is min(|a - b|, 1 - |a - b|) x 2 in [0, 1]. As with FPFH, histograms are in
percent, w_k is the squared distance, and the sum over neighbors is scaled to 100 before HHD(q) is added, so
that the unit of length does not matter.

Beyond the paper, saturation and value can be compared beside hue, one histogram each, and a vote can count by
the saturation of its two points: the hue of gray is noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.descriptors.color import color_values, joint_color_values, soft_equalize
from torchreg.descriptors.descriptor import Descriptor, largest_entries
from torchreg.descriptors.histograms import add_weighted_neighbors, count_votes, neighbor_votes
from torchreg.descriptors.soft.arguments import bin_edges, expect_binning, expect_finite, slot_weights
from torchreg.descriptors.soft.pcfh import soft_pcfh
from torchreg.errors import at_least, expect, expect_shape, one_of
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather
from torchreg.native import call, native, rows
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.neighborhoods import expect_rows
from torchreg.types.precision import full_precision

CHANNELS = ("hue", "saturation", "value")
EQUALIZATIONS = ("none", "cloud", "joint")
MIN_NEIGHBORS = 3
_VOTE_STEPS = 1024  # a weighted vote is a whole number of 1/1024, so that sums are exact


@full_precision
def pcfh(
    cloud: Clouds,
    near: Neighborhoods,
    *,
    bins: int = 11,
    channels: tuple[str, ...] = ("hue",),
    equalization: str = "cloud",
    saturation_weighting: bool = False,
    values: Tensor | None = None,
    binning: str = "hard",
    bandwidth: float = 1.0,
    edges: Tensor | None = None,
    neighbor_weights: Tensor | None = None,
) -> Features:
    """PCFH of every point.

    Args:
        cloud: points and colors; P rows.
        near: the support of every point (the paper: all points within 2 m), the point itself counted.
        bins: equal bins over [0, 1] per channel.
        channels: which of ``"hue"``, ``"saturation"``, ``"value"`` are compared; the paper: hue.
        equalization: of hue, ``"cloud"`` (the paper) or ``"none"``; not read when ``values`` is given.
        saturation_weighting: hue votes count by the product of both points' saturations.
        values: (P, 3) hue, saturation and value in [0, 1] instead of those of ``cloud``, such as jointly
            equalized ones (``joint_color_values``).
        binning, bandwidth, neighbor_weights: as in ``fpfh``; soft binning also equalizes by a smooth cumulative
            distribution (``soft_equalize``), where the bandwidth is a part of a level of hue.
        edges: of soft binning, (channels, bins + 1) ascending from 0 to 1, where the bins of every channel end;
            ``None`` for equal bins. Its first and last column stay 0 and 1.

    Returns:
        Features of one block ("pcfh", bins x channels). A point with fewer than 3 neighbors besides itself
        gets a zero row and is not valid. The same bits for any chunking, batch and number of threads (soft: on the
        CPU).

        No gradients flow through hard histograms. Through soft ones they flow to points, colors (or ``values``),
        edges and neighbor weights, of any order; differences that fold (equal values, opposite hues) and gray
        points have finite ones. Memory stays that of one piece of rows.

    Raises:
        ValueError: no colors, an unknown channel, shapes that do not fit, a bandwidth or edges out of their range, or
            options of soft binning with hard binning.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3), colors=torch.rand(50, 3))
        >>> near = tr.neighbors(cloud, radius=0.5, max_neighbors=20)
        >>> tr.pcfh(cloud, near).values.shape
        torch.Size([50, 11])
    """
    at_least(bins, "bins", 1)
    expect(len(channels) > 0, "channels", "at least one channel", channels)
    for channel in channels:
        one_of(channel, "channels", CHANNELS)
    expect_rows(near, cloud)
    expect_binning(binning, bandwidth, edges=edges, neighbor_weights=neighbor_weights)
    if values is None:
        values = (
            color_values(cloud, equalization)
            if binning == "hard"
            else _soft_color_values(cloud, equalization, bandwidth)
        )
    expect_shape(values, "values", (cloud.points.shape[0], 3), "floating")
    expect_finite(values, "values")
    if binning == "hard":
        hhd, enough = _own_histograms(values, near, bins, channels, saturation_weighting)
        out = add_weighted_neighbors(hhd, near, bins).mul_(enough[:, None])
    else:
        out = soft_pcfh(
            cloud.points,
            values,
            near,
            _neighbor_counts(near) >= MIN_NEIGHBORS,
            bins=bins,
            channels=tuple(map(CHANNELS.index, channels)),
            saturation_weighting=saturation_weighting,
            bandwidth=bandwidth,
            edges=bin_edges(edges, len(channels), bins, values),
            neighbor_weights=slot_weights(neighbor_weights, near, values),
        )
    return Features(out, cloud.offsets, (("pcfh", bins * len(channels)),), valid=largest_entries(out) != 0)


@checked_record
@dataclass(frozen=True, kw_only=True)
class Pcfh(Descriptor):
    """``torchreg.pcfh``: histograms of color differences, by default those of the paper.

    Attributes:
        bins: of every channel's histogram.
        channels: which of ``"hue"``, ``"saturation"`` and ``"value"`` are compared.
        equalization: histogram equalization of hue: ``"none"``, per ``"cloud"``, or ``"joint"``, one map for both
            clouds of a pair.
        saturation_weighting: votes on hue count by the saturation of both points, so that gray points do not count.

    Example:
        >>> import torchreg as tr
        >>> tr.Pcfh(radius=0.25, channels=("hue", "saturation", "value"), equalization="none").bins
        11
    """

    name: ClassVar[str] = "pcfh"
    needs_colors: ClassVar[bool] = True
    is_histogram: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    bins: int = 11
    channels: tuple[str, ...] = ("hue",)
    equalization: str = "cloud"
    saturation_weighting: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "channels", tuple(self.channels))
        at_least(self.bins, "bins", 1)
        expect(len(self.channels) > 0, "channels", "at least one channel", self.channels)
        for channel in self.channels:
            one_of(channel, "channels", CHANNELS)
        one_of(self.equalization, "equalization", EQUALIZATIONS)

    @property
    def is_pairwise(self) -> bool:
        """Whether hue is equalized jointly."""
        return self.equalization == "joint"

    @property
    def reach(self) -> float | None:
        """Meters, as FPFH's; hue that is equalized depends on all points."""
        return 2 * self.radius if self.equalization == "none" else None

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.pcfh``; jointly equalized, ``cloud`` holds the two clouds of one pair."""
        return pcfh(
            cloud,
            near,
            bins=self.bins,
            channels=self.channels,
            equalization="none" if self.is_pairwise else self.equalization,
            saturation_weighting=self.saturation_weighting,
            values=torch.cat(joint_color_values(cloud.select(0), cloud.select(1))) if self.is_pairwise else None,
        )


def difference_bins(query: Tensor, neighbor: Tensor, bins: int, *, circular: bool) -> Tensor:
    """Bin (int64) of the difference of two values in [0, 1]; ``circular`` for hue."""
    difference = (neighbor - query).abs_()
    if circular:
        return torch.minimum(difference, 1 - difference).mul_(2 * bins).clamp_(max=bins - 1).long()
    return difference.mul_(bins).clamp_(max=bins - 1).long()


def _soft_color_values(cloud: Clouds, equalization: str, bandwidth: float) -> Tensor:
    """As ``color_values``, equalized with gradients."""
    values = color_values(cloud, "none")
    if one_of(equalization, "equalization", ("none", "cloud")) == "none":
        return values
    return torch.cat([soft_equalize(values[:, 0], cloud.offsets, bandwidth)[:, None], values[:, 1:]], dim=1)


def _neighbor_counts(near: Neighborhoods) -> Tensor:
    """(P,) int64: the neighbors of every point besides itself."""
    pieces = row_chunks(*near.index.shape)
    parts = [neighbor_votes(near.index, near.valid, rows).sum(dim=1) for rows in pieces]
    return torch.cat(parts) if parts else near.index.new_zeros(0)


def _own_histograms(
    values: Tensor, near: Neighborhoods, bins: int, channels: tuple[str, ...], saturation_weighting: bool
) -> tuple[Tensor, Tensor]:
    """Eq. (3): (P, bins x channels) in percent, and (P,) whether a point had enough neighbors."""
    if native(values, near.index, near.valid) and values.dtype == torch.float32:
        return _histograms_compiled(values, near, bins, channels, saturation_weighting)
    columns = {name: values[:, CHANNELS.index(name)].contiguous() for name in (*channels, "saturation")}
    out = values.new_empty(values.shape[0], bins * len(channels))
    enough = torch.empty(values.shape[0], dtype=torch.bool, device=values.device)
    for part in row_chunks(values.shape[0], near.max_neighbors):
        index = near.index[part]
        ones = neighbor_votes(near.index, near.valid, part).to(torch.int32)
        enough[part] = ones.sum(dim=1) >= MIN_NEIGHBORS
        for place, channel in enumerate(channels):
            column = columns[channel]
            votes = ones
            if channel == "hue" and saturation_weighting:
                saturation = columns["saturation"]
                product = gather(saturation, index) * saturation[part, None]
                votes = (product * _VOTE_STEPS).round_().to(torch.int32) * ones
            bin_ = difference_bins(column[part, None], gather(column, index), bins, circular=channel == "hue")
            counts = count_votes(bin_, votes, bins).to(values.dtype)
            total = votes.sum(dim=1, keepdim=True).clamp_(min=1).to(values.dtype)
            out[part, place * bins : (place + 1) * bins] = counts * (100 / total)
    out *= enough[:, None]
    return out, enough


def _histograms_compiled(
    values: Tensor, near: Neighborhoods, bins: int, channels: tuple[str, ...], saturation_weighting: bool
) -> tuple[Tensor, Tensor]:
    """As ``_own_histograms``."""
    count, width = near.index.shape
    places = torch.tensor([CHANNELS.index(name) for name in channels])
    out = values.new_empty(count, bins * len(channels))
    enough = torch.empty(count, dtype=torch.bool)
    slots = *rows(near.index), *rows(near.valid)
    sizes = count, width, bins, MIN_NEIGHBORS
    asked = values.detach().contiguous(), places, len(places), int(saturation_weighting)
    call("color_histograms", *asked, *slots, *sizes, out, enough)
    return out, enough
