"""PCFH with trained parameters in place of the numbers that the paper fixes by hand (trained by ``torchreg.learning``).

PCFH has equal bins, counts every neighbor alike, and weighs as much as FPFH; histograms are compared as they are. Here
the edges of the bins, the weight of each channel and of the whole block, the weight of every neighbor, and how far the
entries of either block are moved towards their square roots (``fuse.rooted``) are learned. A small network gives a
neighbor's weight from its distance, both saturations, both values, and the cosine between the normals. Before training
the block is the plain rule over hue, saturation and value, not equalized, with equal weights, half way to square roots.

The network is written out in basic operations with x / (1 + |x|) for its curves: no matrix product whose sums depend on
how rows are cut, no function that rounds differently in different lanes.

The weights shipped with the library are in ``learned.json``.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from torchreg.arguments import checked_record
from torchreg.descriptors.color import color_values
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fuse import fuse, rooted
from torchreg.descriptors.pcfh import CHANNELS, pcfh
from torchreg.errors import at_least, expect_in_words, one_of
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather
from torchreg.types import Clouds, Features, Neighborhoods

SHIPPED = Path(__file__).with_suffix(".json")
BLOCK = "learned"
_CUES = 6
_OLD_LAYERS = {"say_in": "cue_layer", "say_out": "weight_layer"}  # names in files of earlier versions


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
        self.log_widths = nn.Parameter(torch.zeros(len(channels), bins, dtype=torch.float32))
        self.log_channels = nn.Parameter(torch.zeros(len(channels), dtype=torch.float32))
        self.log_block = nn.Parameter(torch.zeros((), dtype=torch.float32))
        self.root_logits = nn.Parameter(torch.zeros(2, dtype=torch.float32))  # of geometry and color
        self.cue_layer = nn.Linear(_CUES, hidden, dtype=torch.float32)
        self.weight_layer = nn.Linear(hidden, 1, dtype=torch.float32)
        nn.init.zeros_(self.weight_layer.weight)
        nn.init.zeros_(self.weight_layer.bias)

    def edges(self) -> Tensor:
        """(channels, bins + 1), ascending from 0 to 1. Gradients flow."""
        inner = self.log_widths.softmax(dim=1).cumsum(dim=1)[:, :-1]
        return torch.cat([torch.zeros_like(inner[:, :1]), inner, torch.ones_like(inner[:, :1])], dim=1)

    def block_weight(self) -> Tensor:
        """The weight () of this block relative to FPFH's. Gradients flow."""
        return self.log_block.exp()

    def geometry_root(self) -> Tensor:
        """How far, in (0, 1), FPFH's entries are moved towards their square roots. Gradients flow."""
        return self.root_logits[0].sigmoid()

    def neighbor_weights(self, cloud: Clouds, near: Neighborhoods, values: Tensor, radius: float | Tensor) -> Tensor:
        """The weight (P, K) of every neighbor, in (0, 2); 1 before training.

        Gradients flow to the network, and to values and normals.
        """
        expect_in_words(cloud.normals is not None, "cloud", "normals", "none")
        assert cloud.normals is not None
        reach = radius[:, None].to(near.sq_distance) if isinstance(radius, Tensor) else radius
        columns = [column.contiguous() for column in (*cloud.normals.unbind(dim=1), *values[:, 1:].unbind(dim=1))]
        parts = [self._weigh(columns, near, rows, reach) for rows in row_chunks(len(near), near.max_neighbors)]
        return torch.cat(parts) if parts else near.sq_distance

    def _weigh(self, columns: list[Tensor], near: Neighborhoods, rows: slice, reach: float | Tensor) -> Tensor:
        index = near.index[rows]
        reach = reach[rows] if isinstance(reach, Tensor) else reach
        query, other = [column[rows, None] for column in columns], [gather(column, index) for column in columns]
        distance = torch.where(near.valid[rows], near.sq_distance[rows], 0).clamp(min=0).sqrt() / reach
        agreement = query[0] * other[0] + query[1] * other[1] + query[2] * other[2]
        cues = [distance, agreement, *query[3:], *other[3:]]
        weight = self.weight_layer.bias
        layers = self.cue_layer.weight, self.cue_layer.bias, self.weight_layer.weight[0]
        for factors, bias, out in zip(*layers, strict=True):
            hidden = bias
            for factor, cue in zip(factors, cues, strict=True):
                hidden = hidden + factor * cue
            weight = weight + out * _squashed(hidden)
        return 1 + _squashed(weight)

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
            neighbor_weights=self.neighbor_weights(cloud, near, values, radius),
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


def save_weights(model: LearnedColor, path: Path) -> Path:
    """Write a model's sizes and parameters."""
    content = {
        "bins": model.bins,
        "channels": list(model.channels),
        "hidden": model.hidden,
        "parameters": {name: value.detach().double().tolist() for name, value in model.state_dict().items()},
    }
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path


def load_weights(path: Path = SHIPPED) -> LearnedColor:
    """Read a model that ``save_weights`` wrote; without a path, the one that comes with the library.

    Files of earlier releases, whose layers had other names, are read too.

    Raises:
        FileNotFoundError: no such file.
        RuntimeError: parameters that do not fit the sizes.
    """
    content: dict[str, Any] = json.loads(path.read_text())
    with torch.random.fork_rng(devices=[]):  # the drawn weights are overwritten at once
        model = LearnedColor(bins=content["bins"], channels=tuple(content["channels"]), hidden=content["hidden"])
    parameters = {}
    for name, value in content["parameters"].items():
        layer, dot, rest = name.partition(".")
        parameters[_OLD_LAYERS.get(layer, layer) + dot + rest] = torch.tensor(value, dtype=torch.float32)
    model.load_state_dict(parameters)
    return model.requires_grad_(False)


@checked_record
@dataclass(frozen=True, kw_only=True)
class Learned(Descriptor):
    """Histograms of color differences with trained bins and weights (``torchreg.LEARNED``).

    Example:
        >>> import torchreg as tr
        >>> tr.Learned(radius=2.0).needs_colors
        True
    """

    name: ClassVar[str] = "learned"
    needs_colors: ClassVar[bool] = True
    is_batched: ClassVar[bool] = True

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """The color block of the shipped weights. No gradients."""
        radius = self.radius if near.radius is None else near.radius
        with torch.no_grad():
            features: Features = _shipped(str(cloud.device))(cloud, near.trimmed(), radius)
        return features


def shipped_numbers() -> tuple[float, float]:
    """The shipped block's weight relative to FPFH's, and how far FPFH's entries are moved towards square roots."""
    parameters = json.loads(SHIPPED.read_text())["parameters"]
    return math.exp(parameters["log_block"]), 1 / (1 + math.exp(-parameters["root_logits"][0]))


@cache
def _shipped(device: str) -> LearnedColor:
    return load_weights().to(device)


def _squashed(x: Tensor) -> Tensor:
    """Into (-1, 1), by x / (1 + |x|)."""
    return x / (1 + x.abs())
