"""Pairs of described scans, registered: every candidate becomes a link, those with a chance are refined."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from torchreg.geometry.numerics.partition import partition
from torchreg.refinement.refine import Refined, refine_on_surfels
from torchreg.registration.describe import describe_by
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import pair_bytes
from torchreg.registration.refined import size_of
from torchreg.registration.register import register_described
from torchreg.site.found import has_chance, is_worth_a_look, links_of, refined_link, weighed
from torchreg.site.links import Link
from torchreg.site.pairs import DescriptionKey, Report, SitePair, SiteProgress, alike
from torchreg.site.panorama import Panorama, panorama_of
from torchreg.site.result import TriedPair
from torchreg.site.sight import Sight, between, sight_of, witnessed_by
from torchreg.site.sketches import Sketch, sketch_of
from torchreg.types import Clouds

SLICE_PAIRS = 16
"""Pairs of a slice at most: larger ones save nothing, and progress is seen after each."""


class PairFound(NamedTuple):
    """What registering a pair found.

    Attributes:
        tried: the pair and what became of it.
        links: its candidates, best first.
    """

    tried: TriedPair
    links: tuple[Link, ...]


class SiteWork(Protocol):
    """Where scans are described and pairs of them registered: in memory, or on disk by the processes of an engine.

    What comes does not depend on where, on how pairs are cut into slices, or on what was done before.
    """

    def sketches(self, wanted: Mapping[DescriptionKey, RegistrationOptions]) -> dict[DescriptionKey, Sketch]:
        """What is compared of described scans to choose pairs, each as pairs of these options match it."""

    def registered(self, pairs: Sequence[SitePair], seed: int) -> Iterator[list[PairFound]]:
        """Register pairs, in any order, some at a time; a part without any says that their scans are described."""

    def described(self, key: DescriptionKey) -> DescribedClouds:
        """The described scan of a key, a batch of one."""

    def panorama(self, key: DescriptionKey) -> Panorama | None:
        """What the scanner of a scan saw; ``None`` where its place is not known."""


Sides = Callable[[DescriptionKey], DescribedClouds]
"""The described scan of a key, a batch of one."""


def registered_slice(pairs: Sequence[SitePair], sides: Sides, seed: int) -> list[PairFound]:
    """Register pairs that may go together, and refine their candidates with a chance."""
    result = register_described(*_packed(pairs, sides), [pair.options for pair in pairs], seed=seed)
    links = [links_of(result, number, pair.source, pair.target) for number, pair in enumerate(pairs)]
    wanted = [(row, rank) for row, own in enumerate(links) for rank, link in enumerate(own) if has_chance(link)]
    for begin in range(0, len(wanted), SLICE_PAIRS):
        part = wanted[begin : begin + SLICE_PAIRS]
        T = torch.stack([links[row][rank].T_target_source for row, rank in part])
        refined = _refined([pairs[row] for row, _ in part], sides, T)
        if refined is not None:
            for number, (row, rank) in enumerate(part):
                links[row][rank] = refined_link(links[row][rank], refined, number)
    _ask_scanners(pairs, links, sides)
    found = []
    for number, (pair, own) in enumerate(zip(pairs, links, strict=True)):
        success, candidates = bool(result.success[number]), len(result.candidates[number])
        tried = TriedPair(pair.source, pair.target, success, result.reason[number], candidates)
        found.append(PairFound(tried, tuple(own if pair.options.refine == "none" else weighed(own))))
    return found


def _ask_scanners(pairs: Sequence[SitePair], links: Sequence[list[Link]], sides: Sides) -> None:
    """Ask what the scanners saw under every pose that has a chance."""
    known: dict[DescriptionKey, Sight | None] = {}
    for pair, own in zip(pairs, links, strict=True):
        for key in pair.sides():
            if key not in known:
                surfels = sides(key).surfels
                known[key] = None if surfels is None else sight_of(surfels)
        source, target = (known[key] for key in pair.sides())
        if source is None or target is None:
            continue
        for rank, link in enumerate(own):
            if is_worth_a_look(link):
                T = link.T_target_source
                own[rank] = replace(link, sight=witnessed_by(source, target, T), apart=between(source, target, T))


def _refined(pairs: Sequence[SitePair], sides: Sides, T_target_source: Tensor) -> Refined | None:
    """Poses (K, 4, 4) of K pairs refined on their surfels; ``None`` where they are not to be."""
    source, target = _packed(pairs, sides)
    if pairs[0].options.refine == "none" or source.surfels is None or target.surfels is None:
        return None
    reach = [pair.options.inlier_threshold for pair in pairs]
    sizes = [size_of(cloud) for cloud in source.cloud.unpack()]
    T = T_target_source.to(source.cloud.device)
    return refine_on_surfels(source.surfels, target.surfels, T, reach, [False] * len(pairs), sizes)


def _packed(pairs: Sequence[SitePair], sides: Sides) -> tuple[DescribedClouds, DescribedClouds]:
    """The described sources and targets of pairs."""
    keys = [pair.sides() for pair in pairs]
    source, target = (DescribedClouds.pack([sides(key[side]) for key in keys]) for side in range(2))
    return source, target


class WorkInMemory:
    """Scans at hand, described when they are first needed, in this process.

    Args:
        clouds: the scans, each a batch of one.
        max_bytes: about the memory for the pairs that are registered together.
        report: called at every step.
    """

    def __init__(self, clouds: Sequence[Clouds], *, max_bytes: int, report: Report) -> None:
        self._clouds, self._max_bytes, self._report = clouds, max_bytes, report
        self._described: dict[DescriptionKey, DescribedClouds] = {}

    def sketches(self, wanted: Mapping[DescriptionKey, RegistrationOptions]) -> dict[DescriptionKey, Sketch]:
        """As ``SiteWork``'s."""
        self._describe(list(wanted))
        return {key: sketch_of(self._described[key], option, colored=key.colored) for key, option in wanted.items()}

    def registered(self, pairs: Sequence[SitePair], seed: int) -> Iterator[list[PairFound]]:
        """As ``SiteWork``'s."""
        self._describe([key for pair in pairs for key in pair.sides()])
        yield []
        for places in self._slices(pairs):
            yield registered_slice([pairs[place] for place in places], self._described.__getitem__, seed)

    def described(self, key: DescriptionKey) -> DescribedClouds:
        """As ``SiteWork``'s."""
        self._describe([key])
        return self._described[key]

    def panorama(self, key: DescriptionKey) -> Panorama | None:
        """As ``SiteWork``'s."""
        return panorama_of(self._cloud(key))

    def _cloud(self, key: DescriptionKey) -> Clouds:
        cloud = self._clouds[key.scan]
        return cloud if key.colored else replace(cloud, colors=None)

    def _describe(self, keys: Sequence[DescriptionKey]) -> None:
        missing = [key for key in dict.fromkeys(keys) if key not in self._described]
        total = len(self._described) + len(missing)
        for key in missing:
            self._report(SiteProgress("describe", len(self._described), total))
            self._described[key] = describe_by(self._cloud(key), [key.description], max_bytes=self._max_bytes)
        if missing:
            self._report(SiteProgress("describe", total, total))

    def _slices(self, pairs: Sequence[SitePair]) -> list[list[int]]:
        """The places of pairs that go together, within the memory."""
        slices = []
        for group in alike(pairs):
            points = [sum(len(self._described[key].cloud.points) for key in pairs[place].sides()) for place in group]
            costs = [pair_bytes(count, pairs[place].options) for count, place in zip(points, group, strict=True)]
            for run in partition(costs, self._max_bytes):
                part = group[run]
                slices += [part[begin : begin + SLICE_PAIRS] for begin in range(0, len(part), SLICE_PAIRS)]
        return slices
