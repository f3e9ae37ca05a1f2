"""The pairs of a batch, for any solver, in groups.

A tensor operation on a few hundred matches costs more than its arithmetic. So pairs with similar numbers of matches
are centered, solved, scored and refitted together. The size of a group is bounded by memory; it shows in no result.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.geometry.numerics.partition import partition
from torchreg.solvers.points import PairPoints, gather_points
from torchreg.solvers.poses import PairPoses, no_pose, poses_of
from torchreg.solvers.scoring import QUALITIES
from torchreg.solvers.solver import Hypotheses, Solver
from torchreg.types import Clouds, Correspondences, Failure
from torchreg.types.packing import spans

_GROUP_MATCHES = 1 << 16  # of a group's pairs, at the width of the longest
_GROUP_HYPOTHESES = 1 << 18  # that wait to be scored together


def poses_of_pairs(
    source: Clouds, target: Clouds, matches: Correspondences, solvers: Sequence[Solver], seed: int = 0
) -> list[PairPoses]:
    """The poses of every pair, by its solver; arguments and errors as of ``solve``.

    A pair that cannot be solved has no pose and says why.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.solvers import poses_of_pairs
        >>> problem = tr.synthetic.match_problem(500, 0.8)
        >>> poses, = poses_of_pairs(problem.source, problem.target, problem.matches, [tr.CompatibilityOptions()])
        >>> len(poses.rotation) == len(poses.translation)
        True
    """
    pairs = len(matches)
    expect(len(source) == pairs and len(target) == pairs, "matches", f"{len(source)} pairs", pairs)
    _check_rows(matches.source, source, matches.offsets, "matches.source")
    _check_rows(matches.target, target, matches.offsets, "matches.target")
    counts = matches.offsets.diff().tolist()
    failures = _failures(source, target, matches, solvers)
    poses = {b: no_pose(counts[b], source.device, failure) for b, failure in enumerate(failures) if failure}
    solvable = sorted((b for b, failure in enumerate(failures) if not failure), key=counts.__getitem__)
    for kind in dict.fromkeys(type(solvers[b]) for b in solvable):
        of_kind = [b for b in solvable if type(solvers[b]) is kind]
        for run in partition([counts[b] for b in of_kind], _GROUP_MATCHES, padded=True):
            members = of_kind[run]
            group = [solvers[b] for b in members]
            thresholds = [solver.inlier_threshold for solver in group]
            points = gather_points(source, target, matches, members, thresholds, seed)
            poses.update((members[place], result) for place, result in _solve_group(points, group))
    return [poses[b] for b in range(pairs)]


def too_few_matches(count: int, needed: int) -> Failure:
    """The failure of a pair with fewer matches than determine a transform."""
    text = f"too few matches: {count}, and a sample needs {needed}"
    return Failure("too few matches", text, {"matches": count, "needed": needed})


def _solve_group(points: PairPoints, solvers: Sequence[Solver]) -> Iterator[tuple[int, PairPoses]]:
    """Yield the places of pairs in a group and their poses, as they are ready; all solvers are of one class."""
    waiting: dict[int, Hypotheses] = {}
    stored = 0
    pairs = [points.pair(place) for place in range(len(solvers))]
    for place, hypotheses in enumerate(type(solvers[0]).propose_all(solvers, pairs)):
        failure = hypotheses.failure
        if failure:
            matches, device = points.counts[place], points.source.device
            yield place, no_pose(matches, device, failure, hypotheses.drawn, hypotheses.kept)
            continue
        waiting[place] = hypotheses
        stored += hypotheses.stored
        if stored > _GROUP_HYPOTHESES:
            yield from _refined(points, waiting, solvers)
            waiting, stored = {}, 0
    yield from _refined(points, waiting, solvers)


def _refined(
    points: PairPoints, waiting: dict[int, Hypotheses], solvers: Sequence[Solver]
) -> Iterator[tuple[int, PairPoses]]:
    """Yield the places and poses of pairs with hypotheses; pairs of one dtype and the same options go together."""
    alike: dict[tuple[torch.dtype, int, str], list[int]] = {}
    for place, hypotheses in waiting.items():
        solver = solvers[place]
        alike.setdefault((hypotheses.dtype, solver.local_optimization, solver.scoring), []).append(place)
    for (_, rounds, scoring), places in alike.items():
        part = [waiting[place] for place in places]
        yield from zip(places, poses_of(part, points.take(places), rounds, QUALITIES[scoring]), strict=True)


def _failures(
    source: Clouds, target: Clouds, matches: Correspondences, solvers: Sequence[Solver]
) -> list[Failure | None]:
    """Why a pair cannot be solved, of every pair; ``None`` where it can."""
    finite = [one and other for one, other in zip(_finite(source), _finite(target), strict=True)]
    counts, least = matches.offsets.diff().tolist(), [solver.least_matches for solver in solvers]
    return [
        too_few_matches(count, needed)
        if count < needed
        else (None if sound else Failure("not finite", "points that are not finite"))
        for count, needed, sound in zip(counts, least, finite, strict=True)
    ]


def _finite(clouds: Clouds) -> list[bool]:
    """Whether all points of a cloud are finite, of every cloud."""
    bad = (~torch.isfinite(clouds.points)).any(dim=1).cumsum(dim=0)
    counts: list[int] = torch.nn.functional.pad(bad, (1, 0))[clouds.offsets.to(bad.device)].diff().tolist()
    return [count == 0 for count in counts]


def _check_rows(rows: Tensor, clouds: Clouds, offsets: Tensor, name: str) -> None:
    of_match = offsets.diff().to(rows.device)
    first, end = (
        side.to(rows.device).repeat_interleave(of_match) for side in (clouds.offsets[:-1], clouds.offsets[1:])
    )
    legal = (rows >= first) & (rows < end)
    if bool(legal.all()):
        return
    for (begin, stop), (low, high) in zip(spans(offsets), spans(clouds.offsets), strict=True):
        expect(bool(legal[begin:stop].all()), name, f"rows from {low} to {high - 1} in this pair", rows[begin:stop])
