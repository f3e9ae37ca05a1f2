"""Histogram equalization of hue as a module: per cloud, or by one map for both clouds of a pair."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from torchreg.arguments import checked
from torchreg.descriptors.color import colors_of, hsv, soft_equalize
from torchreg.errors import expect, fraction
from torchreg.types import Clouds
from torchreg.types.packing import offsets_of, spans
from torchreg.types.precision import full_precision


class PairValues(NamedTuple):
    """Hue, saturation and value of both sides, each in [0, 1].

    Attributes:
        source: (P, 3).
        target: (Q, 3).

    Example:
        >>> import torch, torchreg as tr
        >>> values = tr.nn.PairValues(source=torch.rand(50, 3), target=torch.rand(60, 3))
        >>> values.target.shape
        torch.Size([60, 3])
    """

    source: Tensor
    target: Tensor


class Equalize(nn.Module):
    """Hue, saturation and value of every point, hue equalized by ``torchreg.soft_equalize``.

    ``PCFH`` takes the result as ``values``. Gradients flow to colors, finite for gray points.

    Args:
        bandwidth: in (0, 1], of the ramp over which a hue passes from one of 256 levels to the next.

    Raises:
        ValueError: a bandwidth out of its range.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3), colors=torch.rand(50, 3))
        >>> tr.nn.Equalize()(cloud).shape
        torch.Size([50, 3])
    """

    @checked
    def __init__(self, *, bandwidth: float = 1.0) -> None:
        super().__init__()
        self.bandwidth = fraction(bandwidth, "bandwidth")

    @full_precision
    def forward(self, cloud: Clouds) -> Tensor:
        """Values (P, 3) in [0, 1] of packed clouds with colors, every cloud equalized by itself.

        Raises:
            ValueError: no colors.
        """
        values = hsv(colors_of(cloud))
        return _with_hue(soft_equalize(values[:, 0], cloud.offsets, self.bandwidth), values)

    @full_precision
    def joint(self, source: Clouds, target: Clouds) -> PairValues:
        """Values of B source clouds and their B targets, both of a pair equalized by one map.

        Raises:
            ValueError: no colors, or different numbers of clouds.
        """
        expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
        p, q = hsv(colors_of(source)), hsv(colors_of(target))
        pairs = list(zip(*(spans(side.offsets, side.points.shape[0]) for side in (source, target)), strict=True))
        hues = torch.cat([p[:0, 0], *(hue for (i, j), (k, m) in pairs for hue in (p[i:j, 0], q[k:m, 0]))])
        equalized = soft_equalize(hues, offsets_of(j - i + m - k for (i, j), (k, m) in pairs), self.bandwidth)
        parts = equalized.split([size for (i, j), (k, m) in pairs for size in (j - i, m - k)])
        of_source, of_target = (torch.cat([equalized[:0], *parts[side::2]]) for side in (0, 1))
        return PairValues(_with_hue(of_source, p), _with_hue(of_target, q))

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return f"bandwidth={self.bandwidth}"


def _with_hue(hue: Tensor, values: Tensor) -> Tensor:
    return torch.cat([hue[:, None], values[:, 1:]], dim=1)
