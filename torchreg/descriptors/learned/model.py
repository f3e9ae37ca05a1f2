"""PCFH with everything that the paper fixes by hand left to training.

PCFH has equal bins, counts every neighbor alike, and weighs as much as FPFH; histograms are compared as they are. Here
the edges of the bins, the weight of each channel and of the whole block, the say of every neighbor, and how far the
entries of either block are moved towards their square roots (``fuse.rooted``) are learned. A neighbor's say comes from
a small network of what is known about the pair: how far it lies, both saturations, both values, and how much the
normals agree. Before training it is the plain rule over hue, saturation and value, not equalized, with equal weights,
half way to square roots.

The network is written out in basic operations with x / (1 + |x|) for its curves: no matrix product whose sums depend on
how rows are cut, no function that rounds differently in different lanes.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn

from torchreg.descriptors.color import color_values
from torchreg.descriptors.fuse import fuse, rooted
from torchreg.descriptors.histograms import gather
from torchreg.descriptors.pcfh import CHANNELS, pcfh
from torchreg.errors import at_least, expect, one_of
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.types import Clouds, Features, Neighborhoods

BLOCK = "learned"
_CUES = 6


class LearnedColor(nn.Module):
    """A learned color block.

    Args:
        bins: of every channel's histogram.
        channels: which of hue, saturation and value.
        hidden: width of the network that weighs neighbors.

    The parameters start at the plain rule, but for the hidden weights, which are drawn. All have finite gradients
    everywhere.
    """

    def __init__(self, *, bins: int = 11, channels: tuple[str, ...] = CHANNELS, hidden: int = 8) -> None:
        super().__init__()
        self.bins = at_least(bins, "bins", 2)
        self.channels = tuple(one_of(channel, "channels", CHANNELS) for channel in channels)
        self.hidden = at_least(hidden, "hidden", 1)
        self.log_widths = nn.Parameter(torch.zeros(len(channels), bins))
        self.log_channels = nn.Parameter(torch.zeros(len(channels)))
        self.log_block = nn.Parameter(torch.zeros(()))
        self.root_logits = nn.Parameter(torch.zeros(2))  # of geometry and color
        self.say_in = nn.Linear(_CUES, hidden)
        self.say_out = nn.Linear(hidden, 1)
        nn.init.zeros_(self.say_out.weight)
        nn.init.zeros_(self.say_out.bias)

    def edges(self) -> Tensor:
        """(channels, bins + 1), ascending from 0 to 1. Gradients flow."""
        inner = self.log_widths.softmax(dim=1).cumsum(dim=1)[:, :-1]
        return torch.cat([torch.zeros_like(inner[:, :1]), inner, torch.ones_like(inner[:, :1])], dim=1)

    def block_weight(self) -> Tensor:
        """() of this block beside FPFH's 1. Gradients flow."""
        return self.log_block.exp()

    def geometry_root(self) -> Tensor:
        """() in (0, 1), how far FPFH's entries are moved towards their square roots. Gradients flow."""
        return self.root_logits[0].sigmoid()

    def say(self, cloud: Clouds, near: Neighborhoods, values: Tensor, radius: float | Tensor) -> Tensor:
        """(P, K) in (0, 2), how much every neighbor counts; 1 before training.

        Gradients flow to the network, and to values and normals.
        """
        expect(cloud.normals is not None, "cloud", "normals", "none")
        assert cloud.normals is not None
        reach = radius[:, None].to(near.sq_distance) if isinstance(radius, Tensor) else radius
        columns = [column.contiguous() for column in (*cloud.normals.unbind(dim=1), *values[:, 1:].unbind(dim=1))]
        parts = [self._say(columns, near, rows, reach) for rows in row_chunks(len(near), near.max_neighbors)]
        return torch.cat(parts) if parts else near.sq_distance

    def _say(self, columns: list[Tensor], near: Neighborhoods, rows: slice, reach: float | Tensor) -> Tensor:
        index = near.index[rows]
        reach = reach[rows] if isinstance(reach, Tensor) else reach
        own, other = [column[rows, None] for column in columns], [gather(column, index) for column in columns]
        distance = torch.where(near.valid[rows], near.sq_distance[rows], 0).clamp(min=0).sqrt() / reach
        agreement = own[0] * other[0] + own[1] * other[1] + own[2] * other[2]
        cues = [distance, agreement, *own[3:], *other[3:]]
        say = self.say_out.bias
        for weights, bias, out in zip(self.say_in.weight, self.say_in.bias, self.say_out.weight[0], strict=True):
            hidden = bias
            for weight, cue in zip(weights, cues, strict=True):
                hidden = hidden + weight * cue
            say = say + out * _squashed(hidden)
        return 1 + _squashed(say)

    def forward(self, cloud: Clouds, near: Neighborhoods, radius: float | Tensor) -> Features:
        """The color block.

        Args:
            cloud: points, normals and colors; P rows.
            near: the support of every point.
            radius: meters, of that support; one number or one per point (P,).

        Returns:
            Features of one block ("learned", channels x bins), not yet of unit length. Gradients flow to the
            parameters, and to points, normals and colors.
        """
        values = color_values(cloud, "none")
        color = pcfh(
            cloud,
            near,
            bins=self.bins,
            channels=self.channels,
            values=values,
            binning="soft",
            edges=self.edges(),
            neighbor_weights=self.say(cloud, near, values, radius),
        )
        scale = self.log_channels.exp().repeat_interleave(self.bins).to(color.values)
        rows = rooted(color.values, self.root_logits[1].sigmoid().to(color.values)) * scale
        return Features(rows, color.offsets, ((BLOCK, rows.shape[1]),), color.valid)

    def fused(self, geometry: Features, color: Features) -> Features:
        """FPFH and this block as one vector, with the learned root and weight. Gradients flow."""
        root, weight = self.geometry_root().to(geometry.values), self.block_weight().to(geometry.values)
        alike = fuse(replace(geometry, values=rooted(geometry.values, root)), color)
        width = geometry.values.shape[1]
        scale = torch.cat([torch.ones_like(weight).expand(width), weight.expand(color.values.shape[1])])
        return replace(alike, values=alike.values * scale)


def _squashed(x: Tensor) -> Tensor:
    """Into (-1, 1), by x / (1 + |x|)."""
    return x / (1 + x.abs())
