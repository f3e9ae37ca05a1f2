"""Pairs of scans of a site: who is source and who is target, and with which options they are registered."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

from torchreg.registration.describe import description_of
from torchreg.registration.described import Description
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import options_of_pairs
from torchreg.registration.scales import Scale, shared_scales
from torchreg.registration.spacing import options_of_spacings
from torchreg.registration.units import units_failure
from torchreg.site.scan_surfels import surfel_count
from torchreg.site.scans import SiteScans
from torchreg.types.lengths import besides_lengths

FEW_SCANS = 32
"""Sites of more scans are registered on thinner scans, and at the effort ``"fast"`` unless told otherwise."""

ALL_SCANS = 64
"""Sites of no more scans are registered with all their pairs."""


class SiteProgress(NamedTuple):
    """How far the work on a site is.

    Attributes:
        stage: ``"look"`` (reading files), ``"describe"``, ``"compare"`` (cheap signs of overlap), ``"register"``,
            ``"place"`` or ``"refine"`` (all scans together).
        done: of its items.
        total: items of the stage: files, descriptions, pairs, scans. More pairs may be chosen on the way.
        failed: of those done, how many pairs were refused.

    Example:
        >>> from torchreg.site import SiteProgress
        >>> SiteProgress("pairs", done=3, total=10).failed
        0
    """

    stage: str
    done: int
    total: int
    failed: int = 0


Report = Callable[[SiteProgress], None]


class DescriptionKey(NamedTuple):
    """What a description of a scan depends on."""

    scan: int
    description: Description
    colored: bool


class SitePair(NamedTuple):
    """Two scans that are registered with each other, and how."""

    source: int
    target: int
    options: RegistrationOptions
    description: Description  # of both
    colored: bool  # whether both have colors; those of one alone are of no use

    def sides(self) -> tuple[DescriptionKey, DescriptionKey]:
        """The descriptions of source and target."""
        source, target = (DescriptionKey(scan, self.description, self.colored) for scan in (self.source, self.target))
        return source, target

    @property
    def likeness(self) -> Hashable:
        """Equal for pairs that may go together: alike in all but lengths, and in whether both have colors."""
        return besides_lengths(self.options), self.colored


class PairPlan:
    """Every pair of usable scans with its options.

    Roles and order of pairs follow from what the scans hold, so that the order in which scans are given changes
    nothing but their numbers.

    Attributes:
        usable: the scans that can be used, in that order.
    """

    def __init__(self, scans: SiteScans, options: RegistrationOptions | None, effort: str | None) -> None:
        """Args as ``register_site``'s; scans have scales where ``options`` is ``None``."""
        self.usable = scans.usable()
        self._scans, self._options, self._effort = scans, options, effort
        self._place = {scan: place for place, scan in enumerate(self.usable)}
        self._known: dict[Hashable, RegistrationOptions] = {}
        facts = [scans.look(scan).facts for scan in self.usable]
        # scans around a known scanner are dense beside it, and what they share is far off
        around = bool(facts) and all(one.faced for one in facts)
        self._surfels = surfel_count(sorted(one.points for one in facts)[len(facts) // 2]) if around else None
        if options is None:
            scales = {
                scan: scans.look(scan).coarse if self.is_large else scans.look(scan).scale for scan in self.usable
            }
            self._alone = {scan: scale for scan, scale in scales.items() if scale is not None}
            self._shared = {**self._alone, **shared_scales(self._alone, self._of_one_unit())}

    @property
    def is_large(self) -> bool:
        """Whether scans are so many that a pair must not take long."""
        return len(self.usable) > FEW_SCANS

    @property
    def is_whole(self) -> bool:
        """Whether all pairs are registered."""
        return len(self.usable) <= ALL_SCANS

    def all_pairs(self) -> list[tuple[int, int]]:
        """All pairs (source, target)."""
        return [(source, target) for place, target in enumerate(self.usable) for source in self.usable[place + 1 :]]

    def ordered(self, pairs: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
        """Pairs (source, target), each once, in the order of ``all_pairs``."""
        places = {tuple(sorted((self._place[a], self._place[b]))) for a, b in pairs}
        return [(self.usable[last], self.usable[first]) for first, last in sorted(places)]

    def pair(self, source: int, target: int) -> SitePair:
        """One pair with its options."""
        colored = all(self._scans.look(scan).colored for scan in (source, target))
        given = self._derived(source, target, colored) if self._options is None else self._options
        options = options_of_pairs(given, 1, self._effort)[0]
        return SitePair(source, target, options, description_of(options, colored=colored), colored)

    def _derived(self, source: int, target: int, colored: bool) -> RegistrationOptions:
        """As a batch derives them."""
        alone, shared = ([scales[source], scales[target]] for scales in (self._alone, self._shared))
        key = (*alone, *shared, colored)
        if key not in self._known:
            common = Scale(max(scale.voxel for scale in shared), max(scale.spacing for scale in shared))
            apart = (alone[0].spacing, alone[1].spacing)
            voxel = common.voxel if common.voxel > 0 else None
            effort = self._effort or ("fast" if self.is_large else "balanced")
            derived = options_of_spacings(apart, voxel, scale=common.spacing, colored=colored, effort=effort)
            self._known[key] = derived if self._surfels is None else replace(derived, refine_points=self._surfels)
        return self._known[key]

    def _of_one_unit(self) -> list[tuple[int, int]]:
        lengths = {scan: self._scans.look(scan).facts.lengths for scan in self.usable}
        return [(a, b) for a, b in combinations(self.usable, 2) if units_failure(lengths[a], lengths[b]) is None]


def alike(pairs: Sequence[SitePair]) -> list[list[int]]:
    """The places of pairs that may go together."""
    groups: dict[Hashable, list[int]] = {}
    for place, pair in enumerate(pairs):
        groups.setdefault(pair.likeness, []).append(place)
    return list(groups.values())
