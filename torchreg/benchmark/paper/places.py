"""Which scans stand for the paper's mall and for its road.

The paper scanned twice from the same place and then moved the target by an artificial transform, so that the truth is
exact. The simulated scans are taken likewise: the scanner is set up twice within 0.1 m, each scan with noise, light and
passers-by of its own. Stations farther apart, as surveys have them, are harder.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from torchreg.benchmark.core.real_pairs import RealPair, read_real_pairs
from torchreg.benchmark.paper.ways import MAIN_WAYS, OURS, WAYS, Procedure
from torchreg.datasets import ScanPair, mall, road
from torchreg.errors import CloudFileError, at_least
from torchreg.geometry.se3 import transform
from torchreg.io import read_cloud
from torchreg.registration import PAPER
from torchreg.seeds import any_seed
from torchreg.types import Clouds


@dataclass(frozen=True, kw_only=True)
class PlaceGroup:
    """Places whose results are one column of a table: their mean and spread are taken over these places."""

    name: str  # a few words
    title: str  # the same in full
    outdoor: bool = False  # stands for the road rather than the mall
    paper: bool = True  # scanned as in the paper, and not a variant that goes beyond it
    real: bool = False  # scans of real places, at another scale than the paper's
    baseline: float = 0.1  # meters between simulated stations: a tripod set up again, unless it says more


MALL = PlaceGroup(name="mall", title="simulated mall, both scans from one place")
MALL_APART = tuple(
    PlaceGroup(
        name=f"mall, {meters} m apart",
        title=f"simulated mall, stations {meters} m apart",
        paper=False,
        baseline=float(meters),
    )
    for meters in (1, 6)
)
ROAD = PlaceGroup(name="road", title="simulated road, both scans from one place", outdoor=True)
ROAD_APART = PlaceGroup(
    name="road, 6 m apart", title="simulated road, stations 6 m apart", outdoor=True, paper=False, baseline=6.0
)
REAL = PlaceGroup(name="real rooms", title="real rooms, RGB-D", real=True)
REAL_OUTDOOR = PlaceGroup(name="real outdoors", title="real scenes in the open", outdoor=True, real=True)

GROUPS = (MALL, *MALL_APART, REAL, ROAD, ROAD_APART, REAL_OUTDOOR)

LEAST_OVERLAP = 0.6
"""Of real pairs, since the paper scanned twice from the same place."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """One pair of scans."""

    group: PlaceGroup  # of which it is a member
    name: str  # different for every place
    number: int  # of the place within its group, which seeds its random draws
    scale: float  # of the paper's lengths
    ways: tuple[Procedure, ...]  # in which it is registered
    scan: Callable[[], ScanPair]  # makes or reads the two scans

    def clouds(self) -> tuple[Clouds, Clouds]:
        """Source and target in the target's frame: the same coordinates for the same surface."""
        pair = self.scan()
        return transform(pair.source, pair.T_target_source), pair.target


def simulated_places(seed: int, count: int, *, angular_step: float, beyond: int = 0) -> tuple[Place, ...]:
    """Malls and roads ``seed`` to ``seed + count - 1`` from one place, then the first ``beyond`` of them from two.

    A mall comes before the road of its number and both before the next, so that an unfinished run has some of each.
    The first ``beyond`` are registered in all ways, the others in the library's own and the paper's alone.

    Raises:
        ValueError: no integer, or ``count`` below 1.
    """
    any_seed(seed)
    at_least(count, "seeds", 1)

    def place(simulate: Callable[..., ScanPair], group: PlaceGroup, number: int, ways: tuple[Procedure, ...]) -> Place:
        scan = partial(simulate, number, baseline=group.baseline, angular_step=angular_step)
        return Place(group=group, name=f"{group.name}-{number}", number=number, scale=1.0, ways=ways, scan=scan)

    numbers = range(seed, seed + count)
    kinds = ((mall, MALL), (road, ROAD))
    alike = [
        place(*kind, number, WAYS if number - seed < beyond else MAIN_WAYS) for number in numbers for kind in kinds
    ]
    farther = (*((mall, group) for group in MALL_APART), (road, ROAD_APART))
    apart = [place(*kind, number, (OURS,)) for number in numbers[:beyond] for kind in farther]
    return (*alike, *apart)


def real_places(path: Path, seed: int) -> tuple[Place, ...]:
    """The real pairs with colors and much overlap, in the order of their list.

    Their clouds are smaller or larger than a mall: the inlier threshold is the size of voxel that the list gives for a
    pair, and all other lengths keep the paper's proportions to it.

    Args:
        path: as ``read_real_pairs`` takes it.
        seed: of what is drawn.

    Raises:
        CloudFileError: as ``read_real_pairs``, or a list without such a pair.
    """
    listed = [pair for pair in read_real_pairs(path) if pair.colored and pair.overlap >= LEAST_OVERLAP]
    if not listed:
        raise CloudFileError(f"{path}: expected a pair with colors and an overlap of {LEAST_OVERLAP}, got none")
    return tuple(
        Place(
            group=REAL_OUTDOOR if pair.outdoor else REAL,
            name=pair.name,
            number=seed,
            scale=pair.voxel / PAPER.inlier_threshold,
            ways=MAIN_WAYS,
            scan=partial(_read, pair),
        )
        for pair in listed
    )


def _read(pair: RealPair) -> ScanPair:
    return ScanPair(read_cloud(pair.source), read_cloud(pair.target), pair.T_target_source, pair.name)
