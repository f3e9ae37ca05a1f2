"""The pairs of a batch, for any solver, in groups.

A tensor operation on a few hundred matches costs more than its arithmetic. So pairs with similar numbers of matches
are centered, solved, scored and refitted together. The size of a group is bounded by memory; it shows in no result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

import torch

from torchreg.errors import expect
from torchreg.solvers.checks import check_matches, refusals
from torchreg.solvers.found import Found, PairPoses, no_pose, pair_poses
from torchreg.solvers.group import Group, gather_group
from torchreg.solvers.points import MatchedPoints
from torchreg.solvers.proposals import distinct_poses
from torchreg.solvers.refine import QUALITIES
from torchreg.types import Clouds, CompatibilityOptions, Correspondences, RansacOptions

AnyOptions = TypeVar("AnyOptions")
Options = TypeVar("Options", RansacOptions, CompatibilityOptions)

_GROUP_MATCHES = 1 << 16  # of a group's pairs, at the width of the longest
_GROUP_HYPOTHESES = 1 << 18  # that wait to be scored together


def one_per_pair(
    options: AnyOptions | Sequence[AnyOptions] | None, default: AnyOptions, pairs: int
) -> list[AnyOptions]:
    """Options for every pair, from one for all, one per pair, or ``None`` for the default."""
    if not isinstance(options, Sequence):
        return [default if options is None else options] * pairs
    expect(len(options) == pairs, "options", f"one for all or one per pair ({pairs})", len(options))
    return list(options)


def poses_of_pairs(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    solve: Callable[[Sequence[MatchedPoints], Sequence[Options]], Iterable[Found]],
    options: Sequence[Options],
    *,
    least: Sequence[int],
    seed: int = 0,
) -> list[PairPoses]:
    """Run a solver on every pair.

    Args:
        source: B clouds.
        target: B clouds.
        matches: correspondences between them, global rows.
        solve: from the matched points of some pairs and their options to hypotheses of each, in order.
        options: one per pair.
        least: matches that the solver needs, per pair.
        seed: of the call.

    Returns:
        One per pair, in order. A pair that cannot be solved has no pose and says why.

    Raises:
        ValueError: the numbers of pairs differ, or a correspondence names a row outside its pair's clouds.
    """
    check_matches(source, target, matches)
    counts = matches.offsets.diff().tolist()
    found: dict[int, PairPoses] = {}
    solvable = []
    for b, refused in enumerate(refusals(source, target, matches, least)):
        if refused:
            found[b] = no_pose(Found(None, 0, 0, 0, refused), counts[b], source.device)
        else:
            solvable.append(b)
    for members in _groups(sorted(solvable, key=counts.__getitem__), counts):
        thresholds = [options[b].inlier_threshold for b in members]
        group = gather_group(source, target, matches, members, thresholds, seed)
        for place, poses in _solve_group(group, solve, [options[b] for b in members]):
            found[members[place]] = poses
    return [found[b] for b in range(len(matches))]


def _groups(pairs: Sequence[int], counts: Sequence[int]) -> Iterator[list[int]]:
    """Runs of pairs, ascending by their numbers of matches, that fit into ``_GROUP_MATCHES``."""
    group: list[int] = []
    for b in pairs:
        if group and (len(group) + 1) * counts[b] > _GROUP_MATCHES:
            yield group
            group = []
        group.append(b)
    if group:
        yield group


def _solve_group(
    group: Group,
    solve: Callable[[Sequence[MatchedPoints], Sequence[Options]], Iterable[Found]],
    options: Sequence[Options],
) -> Iterator[tuple[int, PairPoses]]:
    """The places of the pairs in the group, and their poses, as they come."""
    waiting: dict[int, Found] = {}
    stored = 0
    pairs = [group.pair(place) for place in range(len(options))]
    for place, found in enumerate(solve(pairs, options)):
        if found.proposals is None:
            yield place, no_pose(found, group.points.counts[place], group.points.source.device)
            continue
        waiting[place] = found
        stored += found.proposals.stored
        if stored > _GROUP_HYPOTHESES:
            yield from _refine(group, waiting, options)
            waiting, stored = {}, 0
    yield from _refine(group, waiting, options)


def _refine(group: Group, waiting: dict[int, Found], options: Sequence[Options]) -> Iterator[tuple[int, PairPoses]]:
    """The distinct poses of pairs with hypotheses; those that are treated alike go together."""
    alike: dict[tuple[torch.dtype, int, str], list[int]] = {}
    for place, found in waiting.items():
        if found.proposals is not None:
            own = options[place]
            alike.setdefault((found.proposals.dtype, own.local_optimization, own.scoring), []).append(place)
    for (_, rounds, scoring), places in alike.items():
        part, solved = group.take(places), [waiting[place] for place in places]
        proposals = [found.proposals for found in solved if found.proposals is not None]
        scored = distinct_poses(proposals, part.points, rounds, QUALITIES[scoring])
        yield from zip(places, pair_poses(scored, part, solved), strict=True)
