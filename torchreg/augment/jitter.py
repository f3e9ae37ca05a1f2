"""Noise on positions."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchreg.augment.augmentation import Augmentation, Tracked, checked_size, unmoved
from torchreg.types import Clouds


class Jitter(Augmentation):
    """Moves every point by normal noise, independent along x, y and z, cut off at ``clip`` deviations.

    Normals and colors stay. Gradients flow to points. The noise is drawn on the CPU, so that it is the same on every
    device.

    Args:
        sigma: meters, the standard deviation before it is cut off.
        clip: standard deviations, the farthest that a coordinate moves.
        probability: as for ``Augmentation``.
        generator: as for ``Augmentation``.

    Raises:
        ValueError: an argument out of its range.

    Example:
        >>> noisy = Jitter(sigma=0.01, clip=2.0)(Clouds(torch.zeros(100, 3)))
        >>> bool(noisy.points.abs().max() <= 0.02)
        True
    """

    def __init__(
        self,
        *,
        sigma: float = 0.005,
        clip: float = 3.0,
        probability: float = 1.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        self.sigma = checked_size(sigma, "sigma", "meters")
        self.clip = checked_size(clip, "clip", "standard deviations")

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """The cloud with noise on its points."""
        noise = torch.randn(len(cloud.points), 3, generator=draw, dtype=cloud.points.dtype)
        noise = self.sigma * noise.clamp_(-self.clip, self.clip)
        return Tracked(replace(cloud, points=cloud.points + noise.to(cloud.device)), unmoved(cloud))

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return f"sigma={self.sigma}, clip={self.clip}, probability={self.probability}"
