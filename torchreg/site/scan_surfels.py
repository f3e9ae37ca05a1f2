"""The surfels of the scans of a site: how many, which of them are in memory, and what is kept of the others."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace

from torchreg.refinement.surfels import Surfels

_POINTS_PER_SURFEL = 5  # measured on buildings of rooms, 27,000 points a scan: 3 and 8 are worse
_FEWEST_SURFELS, _MOST_SURFELS = 500, 20_000
_KEPT = 96  # scans whose surfels are kept in memory


def surfel_count(points: int) -> int:
    """How many surfels to make of a scan of so many points: a fifth, since the surfaces that scans share are far off.

    There points are several times sparser than about the scanner, and surfels that follow those leave out the others.
    """
    return max(_FEWEST_SURFELS, min(_MOST_SURFELS, points // _POINTS_PER_SURFEL))


class ScanSurfels:
    """Surfels of scans; the last ones used are kept."""

    def __init__(self, surfels: Callable[[int], Surfels]) -> None:
        self._surfels, self._lock = surfels, threading.Lock()
        self._kept: OrderedDict[int, Surfels] = OrderedDict()

    def __call__(self, scan: int) -> Surfels:
        """The surfels of one scan, without colors."""
        with self._lock:
            if scan not in self._kept:
                made = self._surfels(scan)
                self._kept[scan] = replace(made, cloud=replace(made.cloud, colors=None))
            self._kept.move_to_end(scan)
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            return self._kept[scan]


@dataclass(frozen=True)
class SurfelFacts:
    """What is kept of the surfels of every scan."""

    count: int  # surfels
    spacing: float
    size: float  # meters, root mean square distance of the surfels from their mean
    faced: bool
    name: tuple[float, ...]  # tells scans apart, wherever they stand among the others


def facts_of(surfels: Surfels) -> SurfelFacts:
    """What is kept of the surfels of one scan."""
    points = surfels.cloud.points.double()
    if len(points) == 0:
        return SurfelFacts(0, 0.0, 0.0, faced=True, name=())
    size = float((points - points.mean(dim=0)).square().sum(dim=1).mean().sqrt())
    faced = bool(surfels.cloud.viewpoint_known[0])
    return SurfelFacts(len(points), surfels.spacing[0], size, faced, tuple(points[0].tolist()))
