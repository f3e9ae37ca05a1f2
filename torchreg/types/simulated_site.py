"""Scans of one simulated place with their true poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.errors import expect_in_words, expect_shape
from torchreg.types.clouds import Clouds
from torchreg.types.held import Held, PerItem, held
from torchreg.types.record import Record
from torchreg.types.shown import counted, listed, several


@dataclass(frozen=True, eq=False, repr=False)
class SimulatedSite(Record):
    """``N`` scans of one place and their true poses, which a registration should find up to a common motion.

    Attributes:
        scans: N batches of one cloud each, in the frame of its own scanner, which stands at zero.
        T_world_scan: (N, 4, 4) float64, meters, the true poses: ``x_world = R @ x_scan + t``.
        floor: (N,) int64, the floor on which each scan was taken; on stairs the one below.
        stations: N names of where the scanner stood.
        name: of the place, for reports.

    Raises:
        ValueError: a scan that is not one cloud, or numbers of scans, poses, floors and names that differ.

    Example:
        >>> import torchreg as tr
        >>> site = tr.datasets.building(seed=1, scans=5, angular_step=4.0)
        >>> len(site.scans), site.T_world_scan.shape
        (5, torch.Size([5, 4, 4]))
    """

    scans: tuple[Clouds, ...] = held(Held(casts=True))
    T_world_scan: Tensor = held(PerItem())
    floor: Tensor = held(PerItem())
    stations: tuple[str, ...] = held(Held())
    name: str = held(Held())

    def __post_init__(self) -> None:
        count = len(self.scans)
        for i, scan in enumerate(self.scans):
            expect_in_words(len(scan) == 1, f"scans[{i}]", "one cloud", f"{len(scan)} clouds")
        expect_shape(self.T_world_scan, "T_world_scan", (count, 4, 4), dtype=torch.float64)
        expect_shape(self.floor, "floor", (count,), dtype=torch.int64)
        expect_in_words(
            len(self.stations) == count, "stations", f"{count} names, one for every scan", f"{len(self.stations)}"
        )

    def _facts(self) -> Sequence[str]:
        points = counted([len(scan.points) for scan in self.scans])
        return f"{self.name!r}, {several(len(self), 'scans')} of {points} points", f"stations {listed(self.stations)}"

    def __len__(self) -> int:
        """The number of scans, N."""
        return len(self.scans)
