"""Other light and another camera: white balance, exposure, gamma and hue."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchreg.augment.augmentation import Augmentation, Tracked, checked_size, unmoved
from torchreg.augment.tone import apply_gamma, from_linear, shift_hue, to_linear
from torchreg.errors import expect
from torchreg.types import Clouds


class Illumination(Augmentation):
    """Changes the colors of every cloud as a whole, as another light or another camera does.

    In linear light, each channel is multiplied by a gain of its own (white balance) and all by one (exposure); then
    come a power on the sRGB values (gamma) and a shift along the color circle (hue). Results are cut off at 0 and 1, so
    no gradient reaches what is bleached; elsewhere gradients flow to colors. A cloud without colors stays as it is.

    Args:
        white_balance: the largest change of red and of blue against green, in stops (factors of two), at most 4.
        exposure: the largest change of brightness, in stops, at most 8.
        gamma: the largest exponent, the least being its inverse; in [1, 4].
        hue: the largest shift of hue, in turns of the color circle, at most 1.
        probability: as for ``Augmentation``.
        generator: as for ``Augmentation``.

    Raises:
        ValueError: an argument out of its range.

    Example:
        >>> dim = Illumination()(Clouds(torch.rand(5, 3), colors=torch.rand(5, 3)))
        >>> bool((dim.colors >= 0).all() and (dim.colors <= 1).all())
        True
    """

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
        """The cloud in other colors."""
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

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        amounts = f"white_balance={self.white_balance}, exposure={self.exposure}, gamma={self.gamma}, hue={self.hue}"
        return f"{amounts}, probability={self.probability}"
