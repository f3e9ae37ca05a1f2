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
        source: batch of one cloud in the frame of its own scanner, colors included.
        target: batch of one cloud in the frame of its own scanner, colors included.
        T_target_source: (4, 4) float64, meters, the true motion: ``x_target = R @ x_source + t``.
        name: says which pair this is, in a report.

    Raises:
        ValueError: a batch of several clouds, a cloud without colors, or ``T_target_source`` of another
            shape or dtype.
    """

    source: Clouds
    target: Clouds
    T_target_source: Tensor
    name: str

    def __post_init__(self) -> None:
        for name, cloud in (("source", self.source), ("target", self.target)):
            expect(len(cloud) == 1, name, "one cloud", f"{len(cloud)} clouds")
            expect(cloud.colors is not None, name, "a cloud with colors", "one without")
        expect_shape(self.T_target_source, "T_target_source", (4, 4))
        expect_dtype(self.T_target_source, "T_target_source", torch.float64)
