"""The paper's features with everything that it fixes by hand left to training.

PCFH has equal bins, counts every neighbor alike, and weighs as much as FPFH; histograms are compared as they are. Here
the edges of the bins, the weight of each channel and of the whole block, the say of every neighbor, and the power to
which the entries of either block are raised are learned. A neighbor's weight comes from a small network of what is
known about the pair: how far it lies, both saturations, both values, and how much the normals agree. A power below 1
keeps a few large entries from deciding alone; at 1/2 the distance of unit rows is Hellinger's (Arandjelovic and
Zisserman, CVPR 2012, doi:10.1109/CVPR.2012.6248018). Before training it is the plain rule over hue, saturation and
value with equal weights.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchreg.descriptors import fuse, pcfh
from torchreg.descriptors.color import color_values
from torchreg.descriptors.fuse import unit_rows
from torchreg.descriptors.histograms import gather
from torchreg.descriptors.soft.equalize import soft_equalize
from torchreg.errors import at_least, expect, one_of, positive
from torchreg.types import Clouds, Features, Neighborhoods

CHANNELS = ("hue", "saturation", "value")
EQUALIZATIONS = ("none", "cloud")
_CUES = 6
_LEAST = 1e-2  # percent


class LearnedColor(nn.Module):
    """FPFH and a learned color block, fused.

    Args:
        bins: of every channel's histogram.
        channels: which of hue, saturation and value.
        hidden: width of the network that weighs neighbors.
        equalization: of hue, ``"none"`` or ``"cloud"``.

    The parameters start at the plain rule. All of them have gradients everywhere.
    """

    def __init__(
        self, *, bins: int = 11, channels: tuple[str, ...] = CHANNELS, hidden: int = 16, equalization: str = "none"
    ) -> None:
        super().__init__()
        self.bins = at_least(bins, "bins", 2)
        self.channels = tuple(one_of(channel, "channels", CHANNELS) for channel in channels)
        self.equalization = one_of(equalization, "equalization", EQUALIZATIONS)
        self.log_widths = nn.Parameter(torch.zeros(len(channels), bins))
        self.log_channels = nn.Parameter(torch.zeros(len(channels)))
        self.log_block = nn.Parameter(torch.zeros(()))
        self.log_powers = nn.Parameter(torch.zeros(2))  # of geometry and color
        self.say = nn.Sequential(nn.Linear(_CUES, hidden), nn.Tanh(), nn.Linear(hidden, 1))
        last = self.say[2]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def edges(self) -> Tensor:
        """(channels, bins + 1), ascending from 0 to 1. Gradients flow."""
        widths = self.log_widths.softmax(dim=1)
        inner = widths.cumsum(dim=1)[:, :-1]
        return torch.cat([torch.zeros_like(inner[:, :1]), inner, torch.ones_like(inner[:, :1])], dim=1)

    def neighbor_weights(self, cloud: Clouds, near: Neighborhoods, values: Tensor, radius: float) -> Tensor:
        """(P, K) above 0, 1 before training. Gradients flow to the network, and to values and normals."""
        expect(cloud.normals is not None, "cloud", "normals", "none")
        assert cloud.normals is not None
        saturation, value = values[:, 1].contiguous(), values[:, 2].contiguous()
        agreement = sum(
            gather(column.contiguous(), near.index) * column[:, None] for column in cloud.normals.unbind(dim=1)
        )
        cues = torch.stack(
            [
                near.sq_distance.clamp(min=0, max=radius * radius).sqrt() / radius,
                saturation[:, None].expand_as(near.sq_distance),
                gather(saturation, near.index),
                value[:, None].expand_as(near.sq_distance),
                gather(value, near.index),
                torch.as_tensor(agreement),
            ],
            dim=2,
        )
        logits = self.say(torch.where(near.valid[..., None], cues, 0).to(self.log_block.dtype))[..., 0]
        return 2 * torch.sigmoid(logits)

    def forward(self, cloud: Clouds, near: Neighborhoods, geometry: Features, radius: float) -> Features:
        """Fused features (P, 33 + channels x bins).

        Args:
            cloud: points, normals and colors.
            near: the support of the color block.
            geometry: FPFH of the same points.
            radius: meters, of that support.

        Gradients flow to the parameters, and to points, normals and colors.
        """
        positive(radius, "radius")
        values = color_values(cloud, "none")
        if self.equalization == "cloud":
            values = torch.cat([soft_equalize(values[:, 0], cloud.offsets)[:, None], values[:, 1:]], dim=1)
        color = pcfh(
            cloud,
            near,
            bins=self.bins,
            channels=self.channels,
            values=values,
            binning="soft",
            edges=self.edges(),
            neighbor_weights=self.neighbor_weights(cloud, near, values, radius),
        )
        powers = self.log_powers.exp().to(color.values)
        scale = self.log_channels.exp().repeat_interleave(self.bins).to(color.values)
        block = unit_rows(raised(color.values, powers[1]) * scale) * self.log_block.exp().to(color.values)
        shape = unit_rows(raised(geometry.values, powers[0]))
        return Features(
            torch.cat([shape, block], dim=1), cloud.offsets, (*geometry.blocks, *color.blocks), geometry.valid
        )


def raised(histograms: Tensor, power: Tensor) -> Tensor:
    """Entries in percent to a power above 0; zero stays zero, with a finite gradient."""
    return (histograms + _LEAST) ** power - _LEAST**power


def plain_color(
    cloud: Clouds, near: Neighborhoods, geometry: Features, channels: tuple[str, ...], equalization: str
) -> Features:
    """The fixed rule: hard PCFH over these channels beside FPFH with equal weights."""
    return fuse(geometry, pcfh(cloud, near, channels=channels, equalization=equalization))
