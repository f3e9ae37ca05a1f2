"""The scanners of a site as witnesses: whatever two of them saw under a pose, asked again and again."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply
from torchreg.site.panorama import Compared, Neutral, Panorama, compared
from torchreg.site.sight import NEAR, Stations, between

_FINE = 0.5  # spacings: poses are asked once for every cell of that size


class SiteSight:
    """What the scanners of a site saw, asked for two scans under poses that come up again and again.

    Args:
        panoramas: of a scan by its number, or ``None``.
        count: of the scans.
    """

    def __init__(self, panoramas: Callable[[int], Panorama | None], count: int) -> None:
        self._panoramas, self._count = panoramas, count
        self.forget()
        self._known: dict[int, Panorama | None] = {}
        self._compared: dict[tuple[int, int, tuple[float, ...]], Compared] = {}

    def forget(self) -> None:
        """Forget what was learned of the site: how far apart stations stand, and what right poses look like."""
        self.stations, self.neutral = Stations(), Neutral()

    def has(self, node: int) -> bool:
        """Whether a node of the graph is a scan whose scanner's place is known."""
        return node < self._count and self.of(node) is not None

    def are_cameras(self) -> bool:
        """Whether there are scanners of known places, none of which sees all around."""
        known = [panorama for panorama in map(self.of, range(self._count)) if panorama is not None]
        return bool(known) and not any(panorama.is_around for panorama in known)

    def scanner(self, scan: int) -> Tensor:
        """The place (3,) of a scanner that is known, in the frame of the scan's file."""
        return self._panorama(scan).scanner

    def of(self, scan: int) -> Panorama | None:
        """What the scanner of a scan saw."""
        if scan not in self._known:
            self._known[scan] = self._panoramas(scan)
        return self._known[scan]

    def odds(self, source: int, target: int, T_target_source: Tensor) -> float:
        """Log-odds for a pose, or against it, from what both saw and from where they would stand."""
        one, other = self.of(source), self.of(target)
        if one is None or other is None:
            return 0.0
        apart = between(one, other, T_target_source)
        if apart > NEAR:
            return 0.0
        return self.neutral.odds(self.compared(source, target, T_target_source)) + self.stations.odds(apart)

    def compared(self, source: int, target: int, T_target_source: Tensor) -> Compared:
        """What two scanners of known places saw under a pose.

        Of poses in one cell of half a spacing that of the first that was asked.
        """
        one, other = self._panorama(source), self._panorama(target)
        fine = _FINE * max(one.spacing, other.spacing)
        shift = (apply(T_target_source, one.scanner[None])[0] - other.scanner) / fine
        turn = T_target_source[:3, :3] * (max(one.reach, other.reach) / fine)
        key = (source, target, tuple(torch.cat([shift, turn.flatten()]).round_().tolist()))
        if key not in self._compared:
            self._compared[key] = compared(one, other, T_target_source)
        return self._compared[key]

    def _panorama(self, scan: int) -> Panorama:
        panorama = self.of(scan)
        if panorama is None:
            raise ValueError(f"scan: expected one whose scanner's place is known, got {scan}")
        return panorama
