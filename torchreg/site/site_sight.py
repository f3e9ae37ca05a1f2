"""The scanners of a site as witnesses: whatever two of them saw under a pose, asked again and again."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.site.panorama import Panorama, looked_at, panorama_of
from torchreg.site.sight import NEAR, Sight, Stations, between


class SiteSight:
    """What the scanners of a site saw, asked for two scans under poses that come up again and again.

    Args:
        sights: the sight of a scan by its number, or ``None``.
        count: of the scans.
    """

    def __init__(self, sights: Callable[[int], Sight | None], count: int) -> None:
        self._sights, self._count = sights, count
        self.stations = Stations()
        self._known: dict[int, Panorama | None] = {}
        self._odds: dict[tuple[int, int, tuple[float, ...]], float] = {}

    def has(self, node: int) -> bool:
        """Whether a node of the graph is a scan whose scanner's place is known."""
        return node < self._count and self.of(node) is not None

    def scanner(self, scan: int) -> Tensor:
        """The place (3,) of a scanner that is known, in the frame of the scan's file."""
        panorama = self.of(scan)
        expect(panorama is not None, "scan", "one whose scanner's place is known", scan)
        return panorama.sight.scanner  # type: ignore[union-attr]  # just checked

    def of(self, scan: int) -> Panorama | None:
        """What the scanner of a scan saw."""
        if scan not in self._known:
            sight = self._sights(scan)
            self._known[scan] = None if sight is None else panorama_of(sight)
        return self._known[scan]

    def odds(self, source: int, target: int, T_target_source: Tensor) -> float:
        """Log-odds for a pose, or against it, from what both saw and from where they would stand.

        Of poses that are within a part of a spacing of each other, those of the first that was asked.
        """
        one, other = self.of(source), self.of(target)
        if one is None or other is None:
            return 0.0
        apart = between(one.sight, other.sight, T_target_source)
        if apart > NEAR:
            return 0.0
        fine = max(one.sight.spacing, other.sight.spacing)
        shift = T_target_source[:3, 3] / fine
        turn = T_target_source[:3, :3] * (max(one.sight.reach, other.sight.reach) / fine)
        key = (source, target, tuple(torch.cat([shift, turn.flatten()]).mul_(2.0).round_().tolist()))
        if key not in self._odds:
            self._odds[key] = looked_at(one, other, T_target_source)
        return self._odds[key] + self.stations.odds(apart)
