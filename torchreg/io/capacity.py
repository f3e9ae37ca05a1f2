"""What a format keeps of a cloud, and in words what a cloud loses in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch

from torchreg.io.fields import PointFields
from torchreg.types import Clouds

_ROUNDING = 1e-6  # of intensities


@dataclass(frozen=True, kw_only=True)
class Capacity:
    """What a file of a format written here keeps, by default all but the finest shades of colors.

    Attributes:
        brightest: the whole number that stands for full brightness; ``None`` where colors stay as they are.
        normals: whether normals are kept.
        scanner: whether the position of the scanner is kept, and whether it is known or assumed.
        claims_scanner: whether a file says where the scanner stood even where nobody knows.
        fields: which of ``PointFields`` are kept, by name.
        intensity: where the scale of intensities ends, which begins at 0; ``None`` where any numbers are kept.
        step: of the coordinates that a cloud gets, in meters, or ``None`` for a cloud that loses no digit; without
            it, none does.
    """

    brightest: int | None = 255
    normals: bool = True
    scanner: bool = True
    claims_scanner: bool = False
    fields: tuple[str, ...] = ()
    intensity: float | None = None
    step: Callable[[Clouds], float | None] | None = None

    def losses(self, cloud: Clouds, fields: PointFields | None = None) -> tuple[str, ...]:
        """What one cloud, and the fields of its points, lose in such a file, a few words each.

        Nothing where all comes back as it is.
        """
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
        if self.claims_scanner and not bool(cloud.viewpoint_known[0]):
            words = "only assumed" if bool(cloud.viewpoint_assumed[0]) else "not known"
            found.append(f"the position of the scanner, which is {words}, is written as if it were known")
        return (*found, *(() if fields is None else self._lost_fields(fields)))

    def _lost_fields(self, fields: PointFields) -> Iterator[str]:
        if fields.scan is not None and "scan" not in self.fields:
            yield "the number of the scan of every point is left out"
        if fields.intensity is None:
            return
        if "intensity" not in self.fields:
            yield "the intensity is left out"
            return
        given, kept = fields.intensity_to(None), fields.intensity_to(self.intensity)
        if given is not None and kept is not None and float(np.abs(given - kept).max(initial=0)) > _ROUNDING:
            yield f"the intensity is scaled to numbers from 0 to {self.intensity:g}"

    def _rounds_colors(self, cloud: Clouds) -> bool:
        if self.brightest is None or cloud.colors is None:
            return False
        levels = cloud.colors.double() * self.brightest
        return bool(((levels - torch.round(levels)).abs() > 1e-3 * self.brightest / 255).any())


USUAL = Capacity()
