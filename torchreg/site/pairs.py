"""All pairs of the scans of a site, registered: each scan is described once, pairs go side by side in slices."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from torch import Tensor

from torchreg.geometry.numerics.partition import partition
from torchreg.refinement.refine import Refined, refine_on_surfels
from torchreg.registration.describe import describe_by, description_of
from torchreg.registration.described import DescribedClouds, Description
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import options_of_pairs, pair_bytes
from torchreg.registration.refined import size_of
from torchreg.registration.register import register_described
from torchreg.registration.scales import Scale, scale_of, shared_scales
from torchreg.registration.spacing import options_of_spacings
from torchreg.registration.units import units_failure
from torchreg.site.scans import SiteScans
from torchreg.types import RegistrationResult
from torchreg.types.lengths import besides_lengths

_SLICE_PAIRS = 16
"""Pairs of a slice at most: larger ones save nothing, and progress is seen after each."""


class SiteProgress(NamedTuple):
    """How far the work on a site is.

    Attributes:
        stage: ``"describe"``, ``"register"`` or ``"place"``.
        done: of its items.
        total: items of the stage: descriptions, pairs, scans.
        failed: of those done, how many pairs were refused.
    """

    stage: str
    done: int
    total: int
    failed: int = 0


Report = Callable[[SiteProgress], None]


class SitePair(NamedTuple):
    """Two scans that are registered with each other, and how."""

    source: int
    target: int
    options: RegistrationOptions
    description: Description  # of both
    colored: bool  # whether both have colors; those of one alone are of no use


class _Key(NamedTuple):
    """What a description of a scan depends on."""

    scan: int
    description: Description
    colored: bool


class DescribedSite:
    """Scans described for their pairs, each once for every set of lengths that its pairs have.

    Attributes:
        pairs: all pairs of usable scans, those that may go together one after another.
    """

    def __init__(
        self,
        scans: SiteScans,
        options: RegistrationOptions | None,
        *,
        effort: str | None,
        max_bytes: int,
        report: Report = lambda _: None,
    ) -> None:
        self._scans, self._max_bytes = scans, max_bytes
        self.pairs = _planned(scans, options, effort)
        wanted = dict.fromkeys(key for pair in self.pairs for key in _keys(pair))
        self._described: dict[_Key, DescribedClouds] = {}
        report(SiteProgress("describe", 0, len(wanted)))
        for done, key in enumerate(wanted, start=1):
            cloud = scans.clouds[key.scan]
            seen = cloud if key.colored else replace(cloud, colors=None)
            self._described[key] = describe_by(seen, [key.description], max_bytes=max_bytes)
            report(SiteProgress("describe", done, len(wanted)))

    def sides(self, pairs: Sequence[SitePair]) -> tuple[DescribedClouds, DescribedClouds]:
        """The described sources and targets of pairs."""
        keys = [_keys(pair) for pair in pairs]
        source, target = (DescribedClouds.pack([self._described[key[side]] for key in keys]) for side in range(2))
        return source, target

    def registered(self, seed: int) -> Iterator[tuple[Sequence[SitePair], RegistrationResult]]:
        """Register all pairs, slice after slice; what comes does not depend on how they are cut."""
        for places in self._slices(self.pairs, range(len(self.pairs))):
            pairs = [self.pairs[place] for place in places]
            yield pairs, register_described(*self.sides(pairs), [pair.options for pair in pairs], seed=seed)

    def refined(self, pairs: Sequence[SitePair], T_target_source: Tensor) -> Iterator[tuple[Sequence[int], Refined]]:
        """Refine poses (K, 4, 4) of K pairs, some of them several times, on their surfels.

        Yields the places of poses among those given, and what became of them; without those of pairs that are not to
        be refined.
        """
        ready = [place for place, pair in enumerate(pairs) if pair.options.refine != "none"]
        for part in self._slices(pairs, ready):
            source, target = self.sides([pairs[place] for place in part])
            if source.surfels is None or target.surfels is None:
                continue
            T = T_target_source[list(part)].to(source.cloud.device)
            reach = [pairs[place].options.inlier_threshold for place in part]
            sizes = [size_of(cloud) for cloud in source.cloud.unpack()]
            yield part, refine_on_surfels(source.surfels, target.surfels, T, reach, [False] * len(part), sizes)

    def _slices(self, pairs: Sequence[SitePair], places: Sequence[int]) -> list[list[int]]:
        """The places of pairs that go together, within the memory."""
        slices = []
        for group in _alike(pairs, places):
            sizes = [sum(len(side.cloud.points) for side in self.sides([pairs[place]])) for place in group]
            costs = [pair_bytes(size, pairs[place].options) for size, place in zip(sizes, group, strict=True)]
            for run in partition(costs, self._max_bytes):
                part = group[run]
                slices += [part[begin : begin + _SLICE_PAIRS] for begin in range(0, len(part), _SLICE_PAIRS)]
        return slices


def _keys(pair: SitePair) -> tuple[_Key, _Key]:
    """Of source and target."""
    source, target = (_Key(scan, pair.description, pair.colored) for scan in (pair.source, pair.target))
    return source, target


def _alike(pairs: Sequence[SitePair], places: Sequence[int]) -> list[list[int]]:
    """Places of pairs that may go together: alike in all but lengths, and in whether both have colors."""
    groups: dict[object, list[int]] = {}
    for place in places:
        groups.setdefault((besides_lengths(pairs[place].options), pairs[place].colored), []).append(place)
    return list(groups.values())


def _planned(scans: SiteScans, options: RegistrationOptions | None, effort: str | None) -> list[SitePair]:
    """All pairs with their options, derived as a batch derives them, or those given."""
    pairs = scans.pairs()
    if not pairs:
        return []
    colored = [all(scans.clouds[scan].colors is not None for scan in pair) for pair in pairs]
    if options is None:
        derived = _derived(scans, pairs, colored, "balanced" if effort is None else effort)
    else:
        derived = [options] * len(pairs)
    every = [options_of_pairs(option, 1, effort)[0] for option in derived]
    return [
        SitePair(source, target, option, description_of(option, colored=both), both)
        for (source, target), option, both in zip(pairs, every, colored, strict=True)
    ]


def _derived(
    scans: SiteScans, pairs: Sequence[tuple[int, int]], colored: Sequence[bool], effort: str
) -> list[RegistrationOptions]:
    alone = {scan: scale_of(scans.clouds[scan]) for scan in sorted({scan for pair in pairs for scan in pair})}
    of_one_unit = [pair for pair in pairs if units_failure(*(scans.facts[scan].lengths for scan in pair)) is None]
    shared = {**alone, **shared_scales(alone, of_one_unit)}
    result = []
    for pair, both in zip(pairs, colored, strict=True):
        scales = [shared[scan] for scan in pair]
        common = Scale(max(scale.voxel for scale in scales), max(scale.spacing for scale in scales))
        apart = (alone[pair[0]].spacing, alone[pair[1]].spacing)
        voxel = common.voxel if common.voxel > 0 else None
        result.append(options_of_spacings(apart, voxel, scale=common.spacing, colored=both, effort=effort))
    return result
