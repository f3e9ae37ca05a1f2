"""Rivals of the pose that most matches agree on: from what is left when its matches are taken away.

Where a scene equals itself after a turn, the better copy takes all mutual matches, and no solver proposes the other. So
an even choice of source points is matched once more, each to its three nearest in feature space and without asking the
targets; matches that the first pose explains are dropped, and the rest is solved. Without colors, by which most copies
differ, what is left also votes for the first pose after a turn (``turned``). What a second consensus proposes then
competes with the first: in a symmetric room both fit, and the verdict says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.matching.shadows import nearest_rows
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.turned import turned
from torchreg.solvers import PairPoses
from torchreg.solvers.batch import poses_of_pairs
from torchreg.types import Clouds, Correspondences, Features
from torchreg.types.packing import offsets_of
from torchreg.verification import ProposedPoses

_SAMPLE = {False: 3000, True: 1000}
"""Source points of a pair that are matched once more, without and with colors, which tell most copies apart."""

_MOST = {False: 2500, True: 1000}
"""Matches of a pair that are solved, the nearest in feature space: time grows with the square."""

_NEAREST = 3  # targets of each
_POSES = 5  # rivals of a pair
_EXPLAINED = 3.0  # inlier thresholds within which the first pose brings a match


class NearMatches(NamedTuple):
    """Matches of one pair, without asking whether they are mutual."""

    source: Tensor  # (M,) int64, rows of the batch of sources
    target: Tensor  # (M,) int64, rows of the batch of targets
    score: Tensor  # (M,), the smaller, the better


def rivals(
    source: Clouds,
    target: Clouds,
    near: Sequence[NearMatches],
    first: ProposedPoses,
    options: Sequence[RegistrationOptions],
    seed: int,
) -> ProposedPoses:
    """The poses that the matches support which the first pose of every pair leaves unexplained.

    Args:
        source: B clouds.
        target: B clouds.
        near: of every pair the matches that may speak for a rival, such as ``nearest_matches``.
        first: of all pairs, a pair's best pose first.
        options: one per pair.
        seed: of every random draw, as the solvers take it.
    """
    colored = source.colors is not None and target.colors is not None
    parts, by_turns = [], []
    for b, option in enumerate(options):
        i, j, score = near[b]
        p, q = source.points[i].double(), target.points[j].double()
        if len(first.poses[b].support) > 0:
            moved = apply_rotation(first.poses[b].rotation[0], p) + first.poses[b].translation[0]
            far = (moved - q).square().sum(dim=1) > (_EXPLAINED * option.inlier_threshold) ** 2
            i, j, score, p, q = (column[far] for column in (i, j, score, p, q))
        nearest = score.sort(stable=True).indices[: _MOST[colored]].sort().values
        parts.append((i[nearest], j[nearest], score[nearest]))
        by_turns.append(None if colored else _turned(first.poses[b], target, b, p, q, nearest, option))
    i, j, score = (torch.cat(column) for column in zip(*parts, strict=True))
    matches = Correspondences(source=i, target=j, offsets=offsets_of(len(part[0]) for part in parts), score=score)
    solvers = [option.solver.at_effort(option.effort) for option in options]
    solved = poses_of_pairs(source, target, matches, solvers, seed=seed)
    poses = [_best(*both) for both in zip(solved, by_turns, strict=True)]
    return ProposedPoses(f"{first.origin}, what its best pose leaves", matches, poses)


def _turned(
    first: PairPoses,
    target: Clouds,
    b: int,
    p: Tensor,
    q: Tensor,
    rows: Tensor,
    option: RegistrationOptions,
) -> PairPoses | None:
    """The best pose of pair ``b`` after turns, by votes of all matches p, q (M, 3), scored on ``rows`` of them."""
    begin, end = target.offsets[b : b + 2].tolist()
    if target.normals is None or len(first.support) == 0 or len(p) == 0:
        return None
    return turned(first.rotation[0], target.normals[begin:end], p, q, option.inlier_threshold, rows)


def _best(solved: PairPoses, by_turns: PairPoses | None) -> PairPoses:
    """The first few poses of one pair that were solved, and of those found by turns."""
    parts = [solved] if by_turns is None else [solved, by_turns]
    rotation, translation, inliers, support, error = (
        torch.cat([column[:_POSES] for column in columns])
        for columns in zip(*(part[:5] for part in parts), strict=True)
    )
    failure = solved.failure if len(support) == 0 else None
    return PairPoses(rotation, translation, inliers, support, error, solved.drawn, solved.kept, solved.scored, failure)


def nearest_matches(features: tuple[Features, Features], *, colored: bool) -> list[NearMatches]:
    """Of every pair, an even choice of source points, each matched to the nearest targets in feature space."""
    return [_nearest(features, b, _SAMPLE[colored]) for b in range(len(features[0]))]


def _nearest(features: tuple[Features, Features], b: int, sample: int) -> NearMatches:
    """The matches of pair ``b``, of so many points, scored by their distances in feature space."""
    rows = []
    for side in features:
        begin, end = side.offsets[b : b + 2].tolist()
        rows.append(begin + side.valid[begin:end].nonzero()[:, 0])
    queries = rows[0][:: max(1, -(-len(rows[0]) // sample))]
    if len(queries) == 0 or len(rows[1]) == 0:
        return NearMatches(queries[:0], queries[:0], features[0].values.new_zeros(0))
    row, distance = nearest_rows(features[0].values[queries], features[1].values[rows[1]], _NEAREST)
    i, j = queries[:, None].expand_as(row).flatten(), rows[1][row.flatten()]
    return NearMatches(i, j, distance.flatten().to(features[0].values))
