"""The scenes that are timed: two stations of a simulated mall, thinned, with all lengths in their spacing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from torchreg.datasets import mall
from torchreg.descriptors.fpfh import fpfh
from torchreg.descriptors.fuse import fuse
from torchreg.descriptors.pcfh import pcfh
from torchreg.matching import match_mutual
from torchreg.neighborhoods import neighbors
from torchreg.preprocess import estimate_normals, random_downsample
from torchreg.registration.spacing import spacing
from torchreg.types import Clouds, Correspondences, Features, Neighborhoods

NEIGHBORS = 100
_FINE, _COARSE = 0.16, 0.4  # degrees between rays; the fine mall has more than a million points a station
_COARSE_UP_TO = 100_000


@dataclass(frozen=True, eq=False)
class TimedCloud:
    """One cloud, and the results of its stages that later ones take."""

    cloud: Clouds  # with colors, without normals
    spacing: float  # meters between its points; supports are 2 (normals, color) and 5 (FPFH) of it
    max_neighbors: int  # slots of the FPFH support

    @cached_property
    def near(self) -> Neighborhoods:
        """The support of FPFH."""
        return neighbors(self.cloud, 5 * self.spacing, self.max_neighbors)

    @cached_property
    def oriented(self) -> Clouds:
        """With normals."""
        return estimate_normals(self.cloud, self.near.restrict(2 * self.spacing, 30))

    @cached_property
    def features(self) -> Features:
        """FPFH and PCFH, fused."""
        return fuse(fpfh(self.oriented, self.near), pcfh(self.oriented, self.near.restrict(2 * self.spacing)))


@dataclass(frozen=True, eq=False)
class TimedScene:
    """Both sides of a pair."""

    source: TimedCloud
    target: TimedCloud

    @cached_property
    def matches(self) -> Correspondences:
        """Mutual matches of the fused features."""
        return match_mutual(self.source.features, self.target.features)


class Scenes:
    """Scenes of any size out of two scans, each scan simulated once."""

    def __init__(self) -> None:
        self._scans: dict[float, tuple[Clouds, Clouds]] = {}

    def scene(self, points: int, max_neighbors: int = NEIGHBORS) -> TimedScene:
        """``points`` a cloud, drawn at random from a mall."""
        step = _COARSE if points <= _COARSE_UP_TO else _FINE
        if step not in self._scans:
            pair = mall(seed=0, angular_step=step)
            self._scans = {step: (pair.source, pair.target)}  # the finer ones are large: one at a time
        sides = []
        for scan in self._scans[step]:
            cloud = random_downsample(scan, points)
            sides.append(
                TimedCloud(cloud, float(spacing(random_downsample(cloud, min(points, 100_000)))[0]), max_neighbors)
            )
        widest = max(side.spacing for side in sides) * (min(points, 100_000) / points) ** 0.5
        return TimedScene(*(TimedCloud(side.cloud, widest, max_neighbors) for side in sides))
