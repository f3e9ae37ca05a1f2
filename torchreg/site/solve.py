"""From scans that can be looked at and registered, wherever that happens, to their poses.

which pairs -> register them -> links -> place     ``rounds``, ``work``, ``placement``
as far as links can be trusted                     ``trust``
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchreg.refinement.surfels import Surfels, surfels_of
from torchreg.site.frame import Framed, SiteFrame, frame_of, judged
from torchreg.site.joint import refine_together
from torchreg.site.links import Link
from torchreg.site.pairs import DescriptionKey, PairPlan, Report, SitePair, SiteProgress
from torchreg.site.panorama import Panorama
from torchreg.site.result import SiteLink, SiteResult
from torchreg.site.rounds import Pair, Standing, first_pairs, most_pairs, next_pairs
from torchreg.site.scans import SiteScans
from torchreg.site.site_sight import SiteSight
from torchreg.site.sketches import Sketch, votes
from torchreg.site.tolerance import Tolerance
from torchreg.site.trust import Trusted, placed, roughly_placed
from torchreg.site.work import PairFound, SiteWork
from torchreg.types import Clouds

_ALIKE = 2.0  # inlier thresholds that poses held to be one are apart, besides what their covariances allow
_DEGREES = 2.0  # likewise
_ROUNDS = 8  # of pairs at most
_TOLD = 500  # comparisons between reports
_NOTHING = Clouds(torch.zeros(0, 3))


def solved(
    scans: SiteScans, plan: PairPlan, work: SiteWork, *, frame: SiteFrame, seed: int, report: Report
) -> SiteResult:
    """Choose pairs, register them, place the scans and refine all of them together, in the frame that is wanted."""
    return _Solver(scans, plan, work, seed, report, frame).solved()


def registered_share(
    scans: SiteScans, plan: PairPlan, work: SiteWork, share: slice, *, seed: int, report: Report
) -> int:
    """Register a share of the pairs with which ``solved`` begins, in their order; returns how many."""
    return _Solver(scans, plan, work, seed, report).registered_share(share)


class Prospects(NamedTuple):
    """What is known of the U usable scans before pairs are registered: votes (U, U) of each two, and their sketches."""

    votes: Tensor
    sketches: Sequence[Sketch]


@dataclass
class _Solver:
    scans: SiteScans
    plan: PairPlan
    work: SiteWork
    seed: int
    report: Report
    frame: SiteFrame = field(default_factory=SiteFrame)
    found: dict[tuple[int, int], PairFound] = field(default_factory=dict)
    pairs: list[SitePair] = field(default_factory=list)
    keys: dict[int, DescriptionKey] = field(default_factory=dict)
    notes: tuple[tuple[str, ...], ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.notes = ((),) * len(self.scans)
        self.sight = SiteSight(self._panorama, len(self.scans))

    def solved(self) -> SiteResult:
        if self.plan.is_whole:
            self._register(self.plan.all_pairs())
            trusted = self._placed(placed)
        else:
            trusted = self._in_rounds()
        return self._result(trusted, self._refined(trusted))

    def registered_share(self, share: slice) -> int:
        if self.plan.is_whole:
            pairs = self.plan.all_pairs()
        else:
            chosen = first_pairs(self._prospects().votes)[: most_pairs(len(self.plan.usable))]
            pairs = self.plan.ordered((self.plan.usable[a], self.plan.usable[b]) for a, b in chosen)
        self._register(pairs[share])
        return len(self.found)

    def _in_rounds(self) -> Trusted:
        usable, most = self.plan.usable, most_pairs(len(self.plan.usable))
        number = {scan: place for place, scan in enumerate(usable)}
        prospects = self._prospects()
        wanted = first_pairs(prospects.votes)
        for _ in range(_ROUNDS):
            chosen = wanted[: most - len(self.found)]
            self._register(self.plan.ordered((usable[a], usable[b]) for a, b in chosen))
            if len(self.found) >= most:
                break
            standing = self._standing(self._placed(roughly_placed), number)
            wanted = next_pairs(prospects.votes, prospects.sketches, standing)
            if not wanted:
                break
        return self._placed(placed)

    def _prospects(self) -> Prospects:
        """The votes of all pairs, and a sketch of every usable scan."""
        begin = time.perf_counter()
        usable, pairs = self.plan.usable, [self.plan.pair(*pair) for pair in self.plan.all_pairs()]
        wanted = {key: pair.options for pair in pairs for key in pair.sides()}
        sketches = self.work.sketches(wanted)
        begin = self._spent("describing", begin)
        agreement = torch.zeros(len(usable), len(usable), dtype=torch.float64)
        place = {scan: k for k, scan in enumerate(usable)}
        for done, pair in enumerate(pairs):
            if done % _TOLD == 0:
                self.report(SiteProgress("compare", done, len(pairs)))
            source, target = (sketches[key] for key in pair.sides())
            a, b = place[pair.source], place[pair.target]
            agreement[a, b] = agreement[b, a] = votes(source, target, pair.options.inlier_threshold)
        self.report(SiteProgress("compare", len(pairs), len(pairs)))
        self._spent("comparing", begin)
        some = {key.scan: sketch for key, sketch in sketches.items()}
        return Prospects(agreement, [some[scan] for scan in usable])

    def _register(self, wanted: Sequence[tuple[int, int]]) -> None:
        """Register pairs (source, target)."""
        begin = time.perf_counter()
        pairs = [self.plan.pair(*pair) for pair in wanted]
        total = len(self.found) + len(pairs)
        self.pairs += pairs
        for part in self.work.registered(pairs, self.seed):
            self.found |= {(one.tried.source, one.tried.target): one for one in part}
            self._tell(total)
        for pair in pairs:
            if self.found[pair.source, pair.target].links:
                self._know(pair.sides())
        self._spent("registering pairs", begin)

    def _know(self, sides: Iterable[DescriptionKey]) -> None:
        """Take descriptions for those of their scans; ones without colors only where there are none with them."""
        for key in sides:
            known = self.keys.get(key.scan)
            if known is None or key.colored or not known.colored:
                self.keys[key.scan] = key

    def _tell(self, total: int) -> None:
        failed = sum(not one.tried.success for one in self.found.values())
        self.report(SiteProgress("register", len(self.found), total, failed))

    def _placed(self, place: Callable[[Sequence[Sequence[Link]], int, Tolerance, SiteSight], Trusted]) -> Trusted:
        begin = time.perf_counter()
        self.report(SiteProgress("place", 0, len(self.scans)))
        candidates = [self.found[pair].links for pair in self._tried()]
        trusted = place(candidates, len(self.scans), self._tolerance, self.sight)
        self.report(SiteProgress("place", len(self.scans), len(self.scans)))
        self._spent("placing", begin)
        return trusted

    @property
    def _reach(self) -> float:
        """Meters, the widest inlier threshold of the pairs."""
        return max((pair.options.inlier_threshold for pair in self.pairs), default=1.0)

    @property
    def _tolerance(self) -> Tolerance:
        return Tolerance(meters=_ALIKE * self._reach, degrees=_DEGREES)

    def _refined(self, trusted: Trusted) -> Framed:
        """The scans in the frame that is wanted, refined together."""
        begin = time.perf_counter()
        framed = frame_of(trusted.placement, self.frame, self._thinned())
        if any(pair.options.refine != "none" for pair in self.pairs):
            refined = refine_together(
                framed.placement,
                trusted.links,
                self._surfels,
                tolerance=self._tolerance,
                reach=self._reach,
                known=framed.known,
                report=self.report,
            )
            agreeing = {place for place, point in enumerate(framed.points) if not point.suspicious}
            points = judged(self.frame.control, refined.placement, agreeing)
            framed = framed._replace(placement=refined.placement, points=points)
            self.notes = refined.notes
        self._spent("refining together", begin)
        return framed

    def _key(self, scan: int) -> DescriptionKey | None:
        """A description of a scan; ``None`` where no pair of it has a candidate: its file may be lost by now."""
        return self.keys.get(scan)

    def _surfels(self, scan: int) -> Surfels:
        key = self._key(scan)
        surfels = None if key is None else self.work.described(key).surfels
        return surfels_of(_NOTHING, 1) if surfels is None else surfels

    def _panorama(self, scan: int) -> Panorama | None:
        key = self._key(scan)
        return None if key is None else self.work.panorama(key)

    def _thinned(self) -> Sequence[Clouds]:
        return _Thinned(self)

    def _tried(self) -> list[tuple[int, int]]:
        """The pairs that were registered, in the order of the plan."""
        return self.plan.ordered(self.found)

    def _standing(self, trusted: Trusted, number: Mapping[int, int]) -> Standing:
        usable, placement = self.plan.usable, trusted.placement
        links = zip(trusted.links, placement.used.tolist(), strict=True)

        def named(pairs: Iterable[tuple[int, int]]) -> frozenset[Pair]:
            return frozenset((min(pair), max(pair)) for pair in ((number[a], number[b]) for a, b in pairs))

        return Standing(
            group=placement.group[usable],
            T_world_scan=placement.T_world_scan[usable],
            tried=named(self.found),
            holding=named((link.source, link.target) for link, is_used in links if is_used),
        )

    def _spent(self, stage: str, begin: float) -> float:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - begin
        return now

    def _result(self, trusted: Trusted, framed: Framed) -> SiteResult:
        placement = framed.placement
        judged = zip(
            trusted.links,
            placement.used.tolist(),
            placement.weight.tolist(),
            placement.meters.tolist(),
            placement.degrees.tolist(),
            placement.loops.tolist(),
            placement.loop_meters.tolist(),
            placement.loop_degrees.tolist(),
            strict=True,
        )
        return SiteResult(
            T_world_scan=placement.T_world_scan,
            group=placement.group,
            covariance=placement.covariance,
            center=placement.center,
            reason=tuple(_reason(self.scans, scan, why) for scan, why in enumerate(placement.reason)),
            notes=tuple((*first, *more) for first, more in zip(self.scans.notes, self.notes, strict=True)),
            links=tuple(SiteLink(*each) for each in judged),
            pairs=tuple(self.found[pair].tried for pair in self._tried()),
            scale=placement.scale,
            doubt=trusted.doubt,
            control=framed.points,
            remarks=framed.remarks,
            seconds=tuple(self.seconds.items()),
        )


class _Thinned(Sequence[Clouds]):
    """The scans as they were described; without points where no pair of theirs has a candidate."""

    def __init__(self, solver: _Solver) -> None:
        self._solver = solver

    def __len__(self) -> int:
        return len(self._solver.scans)

    def __getitem__(self, scan: Any) -> Any:  # noqa: ANN401
        key = self._solver._key(range(len(self))[scan])
        return _NOTHING if key is None else self._solver.work.described(key).cloud


def _reason(scans: SiteScans, scan: int, why: str) -> str:
    """Why a scan is not placed: what is wrong with it alone says more than that no link was found."""
    if not why:
        return ""
    if scans.trouble[scan]:
        return scans.trouble[scan]
    usable = sum(not trouble for trouble in scans.trouble)
    if usable == 1 < len(scans):
        return "it is the only scan that can be used"
    return scans.other_units(scan) or why
