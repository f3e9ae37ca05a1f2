"""Other light and another camera: white balance, exposure, gamma and hue of sRGB colors (P, 3) in [0, 1].

Gradients of all functions are finite everywhere.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from torchreg.arguments import checked
from torchreg.augment.augmentation import Augmentation, Tracked, checked_size, unmoved
from torchreg.descriptors.color import hsv
from torchreg.entry import entry
from torchreg.errors import expect
from torchreg.types import Clouds

_KNEE, _LINEAR_KNEE, _SLOPE, _OFFSET, _POWER = 0.04045, 0.0031308, 12.92, 0.055, 2.4  # IEC 61966-2-1
_DARKEST = 1 / 512  # below it a power would be too steep, and a straight line takes its place


class Illumination(Augmentation):
    """Changes the colors of every cloud as a whole, as another light or another camera does.

    In linear light, each channel is multiplied by a gain of its own (white balance) and all by one (exposure); then
    come a power of the sRGB values (gamma) and a shift along the color circle (hue). Results are clipped to [0, 1], so
    no gradient reaches clipped colors; elsewhere gradients flow to colors. A cloud without colors stays as it is.

    Args:
        white_balance: the largest change of red and of blue against green, in stops (factors of two), at most 4.
        exposure: the largest change of brightness, in stops, at most 8.
        gamma: the largest exponent, the least being its inverse; in [1, 4].
        hue: the largest shift of hue, in turns of the color circle, at most 1.
        probability, generator: as for ``Augmentation``.

    Raises:
        ValueError: an argument out of its range.

    Example:
        >>> dim = Illumination()(Clouds(torch.rand(5, 3), colors=torch.rand(5, 3)))
        >>> bool((dim.colors >= 0).all() and (dim.colors <= 1).all())
        True
    """

    @checked
    def __init__(
        self,
        *,
        white_balance: float = 0.3,
        exposure: float = 0.5,
        gamma: float = 1.2,
        hue: float = 0.0,
        probability: float = 1.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        self.white_balance = checked_size(white_balance, "white_balance", "stops", 4)
        self.exposure = checked_size(exposure, "exposure", "stops", 8)
        number = isinstance(gamma, (int, float)) and not isinstance(gamma, bool)
        expect(number and 1 <= gamma <= 4, "gamma", "a number in [1, 4]", gamma)
        self.gamma = float(gamma)
        self.hue = checked_size(hue, "hue", "turns", 1)

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """Change the colors of one cloud."""
        red, blue, bright, power, turns = (2 * torch.rand(5, generator=draw, dtype=torch.float64) - 1).tolist()
        if cloud.colors is None:
            return Tracked(cloud, unmoved(cloud))
        colors = cloud.colors
        if self.white_balance or self.exposure:
            stops = [self.white_balance * red, 0.0, self.white_balance * blue]
            gains = [2 ** (stop + self.exposure * bright) for stop in stops]
            colors = from_linear(to_linear(colors) * colors.new_tensor(gains)).clamp(0, 1)
        if self.gamma != 1:
            colors = apply_gamma(colors, self.gamma**power)
        if self.hue:
            colors = shift_hue(colors, self.hue * turns).clamp(0, 1)
        return Tracked(replace(cloud, colors=colors), unmoved(cloud))


@entry
def shift_hue(colors: Tensor, turns: float) -> Tensor:
    """Colors whose hue is shifted along the color circle; saturation and value stay, and so do grays.

    Hue is that of HSV (Smith, 1978, doi:10.1145/965139.807361), as PCFH takes it; a whole turn changes nothing.

    Args:
        colors: (P, 3) sRGB in [0, 1].
        turns: of the circle; a third takes red to green.

    Returns:
        (P, 3) in [0, 1]. Gradients flow.

    Raises:
        ValueError: another shape.

    Example:
        >>> shift_hue(torch.tensor([[1.0, 0.0, 0.0]]), 1 / 3).round(decimals=3).tolist()
        [[0.0, 1.0, 0.0]]
    """
    hue, saturation, value = hsv(colors).unbind(1)
    channel = colors.new_tensor([5.0, 3.0, 1.0])
    sector = torch.remainder(6 * (hue + turns)[:, None] + channel, 6.0)  # (P, 3)
    ramp = torch.minimum(sector, 4 - sector).clamp(0, 1)
    return value[:, None] * (1 - saturation[:, None] * ramp)


def to_linear(colors: Tensor) -> Tensor:
    """Linear light of sRGB colors (IEC 61966-2-1). Gradients flow."""
    curve = ((colors.clamp_min(_KNEE) + _OFFSET) / (1 + _OFFSET)) ** _POWER
    return torch.where(colors > _KNEE, curve, colors / _SLOPE)


def from_linear(light: Tensor) -> Tensor:
    """sRGB colors of linear light; brighter than white is above 1. Gradients flow."""
    curve = (1 + _OFFSET) * light.clamp_min(_LINEAR_KNEE) ** (1 / _POWER) - _OFFSET
    return torch.where(light > _LINEAR_KNEE, curve, light * _SLOPE)


def apply_gamma(colors: Tensor, gamma: float) -> Tensor:
    """Colors to the power of ``gamma``; straight below 1/512. Black and white stay. Gradients flow."""
    curve = colors.clamp_min(_DARKEST) ** gamma
    return torch.where(colors > _DARKEST, curve, colors * _DARKEST ** (gamma - 1))
