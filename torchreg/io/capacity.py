"""What a format keeps of a cloud, and in words what a cloud loses in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from torchreg.types import Clouds


@dataclass(frozen=True, kw_only=True)
class Capacity:
    """What a file of a format written here keeps, by default all but the finest shades of colors.

    Attributes:
        brightest: the whole number that stands for full brightness; ``None`` where colors stay as they are.
        normals: whether normals are kept.
        scanner: whether the position of the scanner is kept, and whether it is known or assumed.
        step: of the coordinates that a cloud gets, in meters, or ``None`` for a cloud that loses no digit; without
            it, none does.
    """

    brightest: int | None = 255
    normals: bool = True
    scanner: bool = True
    step: Callable[[Clouds], float | None] | None = None

    def losses(self, cloud: Clouds) -> tuple[str, ...]:
        """What one cloud loses in such a file, a few words each; nothing where it comes back as it is."""
        found = []
        step = None if self.step is None else self.step(cloud)
        if step is not None:
            found.append(f"coordinates are rounded to steps of {step:.1g} m")
        if cloud.normals is not None and not self.normals:
            found.append("normals are left out")
        if self._rounds_colors(cloud):
            found.append(f"colors are rounded to {self.brightest} levels")
        if cloud.viewpoint is not None and not self.scanner:
            words = "assumed" if bool(cloud.viewpoint_assumed[0]) else "known"
            found.append(f"the position of the scanner, which is {words}, is left out")
        return tuple(found)

    def _rounds_colors(self, cloud: Clouds) -> bool:
        if self.brightest is None or cloud.colors is None:
            return False
        levels = cloud.colors.double() * self.brightest
        return bool(((levels - torch.round(levels)).abs() > 1e-3 * self.brightest / 255).any())


USUAL = Capacity()
