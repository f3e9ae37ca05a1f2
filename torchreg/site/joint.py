"""All scans of a frame refined together: ``refine_together``.

Links tie scans along what was registered; where errors of many links add up, scans that see one wall show it twice.
Here every pair that overlaps under the poses says where its surfaces would have it (``refinement/measure.py``), whether
it was registered or not, and all poses follow by robust least squares (``optimize``), round after round, with nearer
partners each time: a Gauss-Newton method on the planes of all scans, whose blocks are those of the pairs.

In a motion that the surfaces of a pair leave open, such as that along a corridor, its link says what it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_in_words, positive
from torchreg.geometry.numerics.threads import shared_out
from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of, rotation_vector
from torchreg.native import kernel_threads, torch_on_one_thread
from torchreg.refinement.measure import Measured, measure
from torchreg.refinement.pairing import Pairing
from torchreg.refinement.surfels import Surfels
from torchreg.site.graph import residuals, site_graph
from torchreg.site.links import KnownPose, Link
from torchreg.site.node_poses import PlacedPoses, entered, left
from torchreg.site.optimize import settle_poses
from torchreg.site.overlaps import FilledCells, filled_cells, overlapping
from torchreg.site.pairs import Report, SiteProgress
from torchreg.site.placement import Placement
from torchreg.site.scan_surfels import ScanSurfels, facts_of
from torchreg.site.ties import mixed, tie
from torchreg.site.tolerance import Tolerance

_STILL = 5e-5  # meters: rounds end when no scan moves by more
_ROUNDS = 15
_NARROWER = 0.5  # of the reach, from one round to the next
_SLOW = 0.7  # of the step before: where steps shrink no faster, half of them is taken
_WEIGHED = 2  # rounds with the nearest partners, after which the covariances of pairs stay
_CELL = 8.0  # spacings of surfels, the edge of the cells that tell which scans overlap
_AT_ONCE = 16  # sources that are measured against one target together
_REPORTED = 16  # such lots, after which progress is reported
_WORST = 0.75  # of the largest excess: scans that are as far astray are held back together
_TURNS = 4  # of holding scans back, after which all that are astray are

HELD_BACK = "its surfaces would move it farther than its links allow: it is held by its links alone"


class Together(NamedTuple):
    """The poses of scans that were refined together."""

    placement: Placement
    notes: tuple[tuple[str, ...], ...]  # remarks on every scan
    pairs: int  # pairs of scans whose surfaces took part


def refine_together(
    placement: Placement,
    links: Sequence[Link],
    surfels: Callable[[int], Surfels],
    *,
    tolerance: Tolerance,
    reach: float,
    known: Iterable[KnownPose] = (),
    report: Report = lambda _: None,
) -> Together:
    """Refine the poses of all scans of every group together, on the surfaces that any two of them share.

    Args:
        placement: N scans, placed by ``links``.
        links: those that it was made from, in the same order.
        surfels: gives the surfels of a scan by its number; perhaps without rows. It must give the same whenever it is
            called: only some scans are kept in memory.
        tolerance: how far links may be off, besides what their covariances allow. A scan that would move farther is
            held by its links alone, and a note says so.
        reach: meters, how far off the poses of two scans may be to begin with: an inlier threshold.
        known: the known poses that the scans were placed by.
        report: called with a ``SiteProgress`` of the stage ``"refine"``.

    Returns:
        The placement with new poses, covariances and centers, and what they mean for the links. The same bits for any
        number of threads.

    Raises:
        ValueError: other links or known poses than those of the placement.
    """
    expect(len(links) == len(placement.used), "links", f"those of the placement ({len(placement.used)})", len(links))
    positive(reach, "reach")
    known = list(known)
    expect_in_words(
        bool(known) or not bool(placement.in_world.any()), "known", "the known poses of the placement", "none"
    )
    with torch_on_one_thread():
        site = _Site(placement, links, known, ScanSurfels(surfels), reach, report)
        held_back: set[int] = set()
        for turn in range(len(placement) + 1):
            poses, pairs = site.refined(held_back)
            astray = {scan: excess for scan, excess in site.astray(poses, tolerance).items() if scan not in held_back}
            if not astray:
                break
            least = _WORST * max(astray.values()) if turn < _TURNS else 0.0
            held_back |= {scan for scan, excess in astray.items() if excess >= least}
        notes = tuple((HELD_BACK,) if scan in held_back else () for scan in range(len(placement)))
        return Together(site.placement_of(poses), notes, pairs)


class _Task(NamedTuple):
    """One pair to measure."""

    target: int
    source: int


class _Demand(NamedTuple):
    """What a pair was found to ask for, and where."""

    measured: Measured | None
    T_target_source: Tensor
    reach: float


class _Site:
    def __init__(
        self,
        placement: Placement,
        links: Sequence[Link],
        known: list[KnownPose],
        surfels: ScanSurfels,
        reach: float,
        report: Report,
    ) -> None:
        self.placement, self.links, self.known, self.surfels, self.reach = placement, links, known, surfels, reach
        self.report = report
        used = [links[row] for row in placement.used.nonzero()[:, 0].tolist()]
        self.used = {(link.target, link.source): link for link in used}
        placed = (placement.group >= 0).nonzero()[:, 0].tolist()
        self.facts = {scan: facts_of(surfels(scan)) for scan in placed}
        # the scan of each group in whose frame all are looked at: the same one in whatever order scans come
        self.middle: dict[int, int] = {}
        for scan in sorted(placed, key=self._rank):
            self.middle[int(placement.group[scan])] = scan

    def refined(self, held_back: set[int]) -> tuple[PlacedPoses, int]:
        """The poses after all rounds, without the surfaces of scans that are held back; and the number of pairs."""
        tasks = self._tasks(held_back)
        kept: dict[_Task, _Demand] = {}
        T = self.placement.T_world_scan.clone()
        nearest = 2 * max((each.spacing for each in self.facts.values()), default=0.0)
        reach, share, last, fine = self.reach, 1.0, torch.inf, 0
        for _ in range(_ROUNDS):
            fine += reach <= nearest
            self._measure(tasks, T, reach, kept, weighed=fine > _WEIGHED)
            poses = self._settled(T, kept, share)
            moved = self._moved(T, poses.T_world_scan)
            T = poses.T_world_scan
            if moved < _STILL and reach <= nearest:
                break
            if reach > nearest:
                reach = max(nearest, _NARROWER * reach)
            else:  # partners that change to and fro
                share, last = (share / 2 if moved > _SLOW * last else share), moved
        return poses, sum(each.measured is not None for each in kept.values())

    def _tasks(self, held_back: set[int]) -> list[_Task]:
        """Pairs that are linked, in the roles of their links, and others that overlap, in those of their surfels."""
        group, T = self.placement.group, self.placement.T_world_scan
        tasks = {_Task(*pair) for pair in self.used}
        linked = {tuple(sorted(pair)) for pair in self.used}
        for number in range(int(group.max()) + 1 if len(group) else 0):
            members = (group == number).nonzero()[:, 0].tolist()
            spacings = sorted(self.facts[scan].spacing for scan in members if self.facts[scan].count > 0)
            if not spacings:
                continue
            edge = _CELL * spacings[len(spacings) // 2]
            faced = all(self.facts[scan].faced for scan in members)
            back = inverse(T[self.middle[number]])
            cells = [self._cells(scan, compose(back, T[scan]), edge, faced=faced) for scan in members]
            for i, j in overlapping(cells):
                pair = (members[i], members[j])
                if pair not in linked:
                    tasks.add(_Task(*sorted(pair, key=self._rank)))
        free = [task for task in sorted(tasks) if not held_back.intersection(task)]
        return [task for task in free if min(self.facts[scan].count for scan in task) > 0]

    def _cells(self, scan: int, T: Tensor, edge: float, *, faced: bool) -> FilledCells:
        cloud = self.surfels(scan).cloud.to(device="cpu")
        normals = cloud.points if cloud.normals is None else cloud.normals
        return filled_cells(cloud.points.double() + cloud.origin, normals, T, edge, faced=faced)

    def _measure(
        self, tasks: Sequence[_Task], T: Tensor, reach: float, kept: dict[_Task, _Demand], *, weighed: bool
    ) -> None:
        """Measure the pairs whose poses have changed since they were measured.

        Where they are ``weighed``, each keeps its covariance, so that rounds come to an end: whether surfaces hold a
        motion at all is a yes or no, and near the bound it changes with a few partners.
        """
        between = {task: compose(inverse(T[task.target]), T[task.source]) for task in tasks}
        waiting = [task for task in tasks if self._changed(task, between[task], reach, kept.get(task))]
        done = len(tasks) - len(waiting)
        self.report(SiteProgress("refine", done, len(tasks)))
        parts = list(_parts(waiting))
        for begin in range(0, len(parts), _REPORTED):
            for made in self._work(parts[begin : begin + _REPORTED], between, reach):
                for task, one in made.items():
                    kept[task] = _as_weighed(one, kept[task]) if weighed and task in kept else one
                done += len(made)
            self.report(SiteProgress("refine", done, len(tasks)))

    def _work(
        self, parts: list[list[_Task]], between: Mapping[_Task, Tensor], reach: float
    ) -> list[dict[_Task, _Demand]]:
        device = self.surfels(parts[0][0].target).cloud.device

        def run(part: list[_Task]) -> dict[_Task, _Demand]:
            sources, target = [self.surfels(task.source) for task in part], self.surfels(part[0].target)
            T = torch.stack([between[task] for task in part]).to(device)
            pairing = Pairing(range(len(part)), [0] * len(part))
            found = measure(Surfels.pack(sources), target, pairing, T, [reach] * len(part))
            return {task: _Demand(one, between[task], reach) for task, one in zip(part, found, strict=True)}

        workers = kernel_threads() if device.type == "cpu" else 1
        return shared_out(run, parts, workers) if workers > 1 else list(map(run, parts))

    def _changed(self, task: _Task, T: Tensor, reach: float, kept: _Demand | None) -> bool:
        if kept is None or kept.reach != reach:
            return True
        size = self.facts[task.source].size
        return _motion(kept.T_target_source, T, size) > 0.2 * _STILL

    def _settled(self, T: Tensor, kept: Mapping[_Task, _Demand], share: float) -> PlacedPoses:
        """The poses that all pairs agree on, links where surfaces say nothing; reached from ``T`` by a share."""
        ties = []
        for key, link in self.used.items():
            one = kept.get(_Task(*key))
            ties.append(link if one is None or one.measured is None else mixed(link, one.measured))
        for task, one in sorted(kept.items(), key=lambda item: item[0]):
            if tuple(task) not in self.used and one.measured is not None:
                ties.append(tie(task.target, task.source, one.measured))
        graph = site_graph(ties, self.known, len(T))
        start, fixed = entered(graph, self.placement, T)
        settled = settle_poses(graph, start, fixed)
        step = compose(inverse(start), settled.poses)
        step = rigid(rotation_of(share * rotation_vector(step[:, :3, :3])), share * step[:, :3, 3])
        return left(graph, self.placement, settled._replace(poses=compose(start, step)))

    def _moved(self, before: Tensor, after: Tensor) -> float:
        """Meters by which the points of any scan move, in the frame of one scan of its group."""
        most = 0.0
        for scan, facts in self.facts.items():
            middle = self.middle[int(self.placement.group[scan])]
            one, other = (compose(inverse(T[middle]), T[scan]) for T in (before, after))
            most = max(most, _motion(one, other, facts.size))
        return most

    def _rank(self, scan: int) -> tuple[int, tuple[float, ...]]:
        """By what a scan holds."""
        return self.facts[scan].count, self.facts[scan].name

    def astray(self, poses: PlacedPoses, tolerance: Tolerance) -> dict[int, float]:
        """Scans whose links the poses leave farther than is allowed, and by how much all of each are left.

        Links are asked, not how far scans move: errors of many links add up, and what mends them moves scans far.
        """
        graph = site_graph(list(self.used.values()), (), len(self.placement))
        variances = tolerance.variances(graph, self.placement.scale)
        excess = []
        for T in (self.placement.T_world_scan, poses.T_world_scan):
            e = residuals(graph, entered(graph, self.placement, T)[0])
            turn, shift = (torch.linalg.vector_norm(part, dim=1) for part in e.split(3, dim=1))
            excess.append(tolerance.excess(turn, shift, *variances))
        far = excess[1] > excess[0].clamp(min=1)
        result: dict[int, float] = {}
        for first, second, much in zip(
            *(part[far].tolist() for part in (graph.first, graph.second, excess[1])), strict=True
        ):
            for scan in (first, second):
                result[scan] = result.get(scan, 0.0) + much
        return result

    def placement_of(self, poses: PlacedPoses) -> Placement:
        """The placement with these poses, and how far links are from them."""
        graph = site_graph(self.links, self.known, len(self.placement))
        start, _ = entered(graph, self.placement, poses.T_world_scan)
        e = residuals(graph, start)
        back = graph.number.argsort()[: len(self.links)]
        turn, shift = (torch.linalg.vector_norm(part, dim=1)[back] for part in e.split(3, dim=1))
        one = ~self.placement.meters.isnan()
        return replace(
            self.placement,
            T_world_scan=poses.T_world_scan,
            covariance=poses.covariance,
            center=poses.center,
            meters=torch.where(one, shift, torch.nan),
            degrees=torch.where(one, torch.rad2deg(turn), torch.nan),
            scale=poses.scale,
        )


def _as_weighed(one: _Demand, before: _Demand) -> _Demand:
    """The pose that a pair asks for now, with the weight that it had before."""
    if one.measured is None or before.measured is None:
        return one._replace(measured=before.measured)
    known = before.measured
    return one._replace(measured=one.measured._replace(covariance=known.covariance, center=known.center))


def _parts(tasks: Sequence[_Task]) -> Iterator[list[_Task]]:
    """Pairs of one target, some at once."""
    part: list[_Task] = []
    for task in tasks:
        if part and (task.target != part[0].target or len(part) == _AT_ONCE):
            yield part
            part = []
        part.append(task)
    if part:
        yield part


def _motion(before: Tensor, after: Tensor, size: float) -> float:
    """Meters by which points within ``size`` of the scanner move."""
    turn = float((after[:3, :3] - before[:3, :3]).square().sum().div(2).sqrt())
    return float((after[:3, 3] - before[:3, 3]).norm()) + turn * size
