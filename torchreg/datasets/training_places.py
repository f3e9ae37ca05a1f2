"""Simulated places to train on: pairs of scans of malls, roads and office buildings, other ones for every seed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from torchreg.entry import entry
from torchreg.errors import at_least
from torchreg.learning.posed_pairs import PosedPair
from torchreg.metrics import overlap
from torchreg.preprocess import voxel_downsample
from torchreg.synthetic import building, mall, road
from torchreg.types.scan_pair import ScanPair

GROUPS = ("malls", "roads", "buildings")
"""Groups of simulated pairs, by their names."""

MALL_VOXEL, ROAD_VOXEL, BUILDING_VOXEL = 0.2, 0.3, 0.1  # meters
_STEP = 0.7  # degrees between rays
_SCANS = 6  # of a building
_LEAST_OVERLAP, _PAIRS = 0.3, 3  # of two of its scans, and how many pairs of them at most


@entry
def simulated_pairs(first: int, places: int) -> Iterator[PosedPair]:
    """Pairs of malls, roads and buildings, so many places of each, in turn.

    Stations stand 2 to 8 m apart; light, furniture and people differ between them. From a building come up to three
    pairs of scans that overlap by 0.3 at least.

    Args:
        first: seed of the first place of each kind; others follow it.
        places: of each kind, at least 0.

    The same arguments give the same bits.

    Example:
        >>> import torchreg as tr
        >>> posed = next(tr.datasets.simulated_pairs(first=0, places=1))
        >>> posed.group, posed.pair.name
        ('malls', 'mall-0')
    """
    at_least(first, "first", 0)
    at_least(places, "places", 0)
    for seed in range(first, first + places):
        draw = np.random.default_rng((seed, 7))
        apart = (float(draw.uniform(2, 8)), float(draw.uniform(2, 8)))
        yield PosedPair(mall(seed, baseline=apart[0], angular_step=_STEP), "malls", MALL_VOXEL)
        yield PosedPair(road(seed, baseline=apart[1], angular_step=_STEP), "roads", ROAD_VOXEL)
        yield from _of_building(seed)


def _of_building(seed: int) -> Iterator[PosedPair]:
    site = building(seed, scans=_SCANS, floors=1, angular_step=2 * _STEP)
    coarse = [voxel_downsample(scan, 3 * BUILDING_VOXEL) for scan in site.scans]
    found = 0
    for i, j in combinations(range(len(site)), 2):
        T = site.T_world_scan[j].inverse() @ site.T_world_scan[i]
        if float(overlap(coarse[i], coarse[j], T[None], 3 * BUILDING_VOXEL)) >= _LEAST_OVERLAP:
            name = f"{site.name}-{site.stations[i]}-{site.stations[j]}"
            yield PosedPair(ScanPair(site.scans[i], site.scans[j], T, name), "buildings", BUILDING_VOXEL)
            found += 1
            if found == _PAIRS:
                return
