"""The pairs of the study: of two lists, an even choice of them, thinned where they have too many points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from torchreg.benchmark.core.real_pairs import RealPair, read_real_pairs
from torchreg.errors import expect
from torchreg.io import read_cloud
from torchreg.preprocess import voxel_downsample
from torchreg.types import Clouds

_MARGIN = 1.02  # of an edge that leaves fewer points


@dataclass(frozen=True, eq=False)
class FamilyPair:
    """A pair, and the list that it is of.

    Attributes:
        of_list: ``"real"`` or ``"hard"``, a section of the tables.
        pair: the pair; its scene is its group.
    """

    of_list: str
    pair: RealPair

    @property
    def key(self) -> str:
        """Its name, different for every pair of both lists."""
        return f"{self.of_list}/{self.pair.name}"


class ThinPair(NamedTuple):
    """Both clouds of a pair, means over voxels."""

    source: Clouds
    target: Clouds
    edge: float  # meters, of these voxels
    colored: bool  # whether both have colors, which the list does not deny


def chosen_pairs(
    lists: Sequence[tuple[str, Path | None]],
    *,
    every: int = 1,
    scenes: Sequence[str] | None = None,
    quick: bool = False,
) -> list[FamilyPair]:
    """The pairs of lists, each a name and a path.

    Args:
        lists: a path is a list of pairs or the folder that holds it, or ``None`` for no pairs.
        every: of each list the first pair and every so many-th after it.
        scenes: only theirs; ``None`` takes all.
        quick: of every list the pair that overlaps most, alone.

    Raises:
        CloudFileError: a list that cannot be read.
        ValueError: no list, or a scene that none has.
    """
    listed = [(name, read_real_pairs(path)) for name, path in lists if path is not None]
    expect(len(listed) > 0, "pairs", "a list of pairs (--real, --hard)", "none")
    known = list(dict.fromkeys(pair.scene for _, pairs in listed for pair in pairs))
    for scene in scenes or ():
        expect(scene in known, "scenes", "scenes out of " + ", ".join(known), scene)
    chosen = []
    for name, pairs in listed:
        of_scenes = [pair for pair in pairs if scenes is None or pair.scene in scenes]
        if quick:
            of_scenes = sorted(of_scenes, key=lambda pair: -pair.overlap)[:1]
        chosen += [FamilyPair(name, pair) for pair in of_scenes[::every]]
    return chosen


def thin_pair(pair: RealPair, most: int | None = None) -> ThinPair:
    """Read a pair and average it over its voxels, or over wider ones until neither cloud has more than ``most`` points.

    Raises:
        CloudFileError: a cloud that cannot be read.
    """
    given = read_cloud(pair.source), read_cloud(pair.target)
    edge = pair.voxel
    source, target = (voxel_downsample(cloud, edge) for cloud in given)
    while most is not None and (points := max(len(source.points), len(target.points))) > most:
        edge *= _MARGIN * math.sqrt(points / most)
        source, target = (voxel_downsample(cloud, edge) for cloud in given)
    colored = pair.colored and source.colors is not None and target.colors is not None
    if not colored:
        source, target = (replace(cloud, colors=None) for cloud in (source, target))
    return ThinPair(source, target, edge, colored)
