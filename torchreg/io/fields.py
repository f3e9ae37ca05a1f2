"""What a file may hold of every point beside what a cloud has: its intensity, and which scan it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.errors import expect, expect_in_words, expect_shape

_TOPS = (1.0, 255.0, 65535.0)
"""The largest numbers of the usual scales of intensity, which begin at 0."""


@checked_record
@dataclass(frozen=True, eq=False, kw_only=True)
class PointFields:
    """Numbers that go with the points of one cloud; a field that is ``None`` is not there.

    Attributes:
        intensity: (P,) of the returns, in any scale.
        scan: (P,) int64 from 0 to 65535, the number of the scan that a point comes from.

    Raises:
        ValueError: another shape or dtype, or a number out of range.

    Example:
        >>> import torch, torchreg as tr
        >>> fields = tr.io.PointFields(intensity=torch.rand(10))
        >>> tr.write_cloud("a.laz", tr.Clouds(torch.rand(10, 3)), fields=fields)
    """

    intensity: Tensor | None = None
    scan: Tensor | None = None

    def __post_init__(self) -> None:
        if self.intensity is not None:
            expect_shape(self.intensity, "intensity", ("P",), "floating")
        if self.scan is not None:
            expect(self.scan.ndim == 1 and self.scan.dtype.is_signed, "scan", "(P,) int64", self.scan)
            legal = len(self.scan) == 0 or (int(self.scan.min()) >= 0 and int(self.scan.max()) <= 65535)
            expect_in_words(legal, "scan", "numbers from 0 to 65535", f"{self.scan.tolist()[:5]}")

    def checked(self, count: int) -> PointFields:
        """Return these fields if they belong to ``count`` points, else raise ``ValueError``."""
        for name in ("intensity", "scan"):
            value = getattr(self, name)
            expect(value is None or len(value) == count, f"fields, {name}", f"({count},)", value)
        return self

    def intensity_to(self, top: float | None) -> NDArray[Any] | None:
        """The intensity (P,) float64 in the scale of a format (``scaled_intensity``), or ``None`` without one."""
        return None if self.intensity is None else scaled_intensity(self.intensity.detach().cpu().numpy(), top)


def scaled_intensity(values: NDArray[Any], top: float | None) -> NDArray[Any]:
    """Intensities (P,) float64 for a format whose scale ends at ``top``; whole numbers where that is above 1.

    What fits stays as it is. Else the scale of the values is taken to end at 1, 255 or 65535, and where they reach
    beyond all of these, they are spread from their lowest to their highest. What is not finite becomes 0. ``None`` for
    ``top`` means a format that takes all numbers.
    """
    wide = values.astype(np.float64)
    if top is None:
        return wide
    wide = np.where(np.isfinite(wide), wide, 0.0)
    low, high = (float(wide.min()), float(wide.max())) if len(wide) else (0.0, 0.0)
    is_whole = bool((wide == np.floor(wide)).all())
    if low >= 0 and high <= top and (top == 1 or (is_whole and high > 1)):
        return wide
    own = next((one for one in _TOPS if low >= 0 and high <= one), None)
    unit = wide / own if own is not None else (wide - low) / max(high - low, 1e-300)
    return unit if top == 1 else np.round(unit * top)
