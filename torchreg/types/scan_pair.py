"""Two scans of one place and the true motion between them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.errors import expect, expect_dtype, expect_shape
from torchreg.types.clouds import Clouds


@dataclass(frozen=True, eq=False)
class ScanPair:
    """A source scan, a target scan and the truth that a registration should find.

    Attributes:
        source: batch of one cloud in the frame of its own scanner.
        target: batch of one cloud in the frame of its own scanner.
        T_target_source: (4, 4) float64, meters, the true motion: ``x_target = R @ x_source + t``, origins
            included. NaN throughout where the truth is not known.
        name: says which pair this is, in a report.
        information: (6, 6) float64, the information matrix of the truth as 3DMatch gives it, or ``None``.

    Raises:
        ValueError: a batch of several clouds, or a matrix of another shape or dtype.
    """

    source: Clouds
    target: Clouds
    T_target_source: Tensor
    name: str
    information: Tensor | None = None

    def __post_init__(self) -> None:
        for name, cloud in (("source", self.source), ("target", self.target)):
            expect(len(cloud) == 1, name, "one cloud", f"{len(cloud)} clouds")
        expect_shape(self.T_target_source, "T_target_source", (4, 4))
        expect_dtype(self.T_target_source, "T_target_source", torch.float64)
        if self.information is not None:
            expect_shape(self.information, "information", (6, 6))
            expect_dtype(self.information, "information", torch.float64)

    @property
    def has_truth(self) -> bool:
        """Whether the true motion is known."""
        return bool(self.T_target_source.isfinite().all())
