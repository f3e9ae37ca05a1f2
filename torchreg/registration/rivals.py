"""Rivals of the pose that most matches agree on: from what is left when its matches are taken away.

Where a scene equals itself after a turn, the better copy takes all mutual matches, and no solver proposes the other. So
an even choice of source points is matched once more, each to its three nearest in feature space and without asking the
targets; matches that the first pose explains are dropped, and the rest is solved. What a second consensus proposes then
competes with the first: in a symmetric room both fit, and the verdict says so.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.matching.nearest import feature_nearest
from torchreg.registration.options import RegistrationOptions
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


def rivals(
    source: Clouds,
    target: Clouds,
    features: tuple[Features, Features],
    first: ProposedPoses,
    options: Sequence[RegistrationOptions],
    seed: int,
) -> ProposedPoses:
    """The poses that the matches support which the first pose of every pair leaves unexplained.

    Args:
        source: B clouds.
        target: B clouds.
        features: those of both sides that ``first`` was matched by.
        first: of all pairs, a pair's best pose first.
        options: one per pair.
        seed: of every random draw, as the solvers take it.
    """
    colored = source.colors is not None and target.colors is not None
    parts = []
    for b, option in enumerate(options):
        i, j, score = _nearest(features, b, _SAMPLE[colored])
        if len(first.poses[b].support) > 0:
            p, q = source.points[i].double(), target.points[j].double()
            moved = apply_rotation(first.poses[b].rotation[0], p) + first.poses[b].translation[0]
            far = (moved - q).square().sum(dim=1) > (_EXPLAINED * option.inlier_threshold) ** 2
            i, j, score = i[far], j[far], score[far]
        nearest = score.sort(stable=True).indices[: _MOST[colored]].sort().values
        parts.append((i[nearest], j[nearest], score[nearest]))
    i, j, score = (torch.cat(column) for column in zip(*parts, strict=True))
    matches = Correspondences(source=i, target=j, offsets=offsets_of(len(part[0]) for part in parts), score=score)
    solvers = [option.solver.at_effort(option.effort) for option in options]
    poses = [_best(each) for each in poses_of_pairs(source, target, matches, solvers, seed=seed)]
    return ProposedPoses(f"{first.origin}, what its best pose leaves", matches, poses)


def _best(poses: PairPoses) -> PairPoses:
    """The first few of the poses of one pair."""
    columns = ("rotation", "translation", "inliers", "support", "error")
    return poses._replace(**{name: getattr(poses, name)[:_POSES] for name in columns})


def _nearest(features: tuple[Features, Features], b: int, sample: int) -> tuple[Tensor, Tensor, Tensor]:
    """Source rows, target rows and feature distances of the matches of pair ``b``, of so many points."""
    rows = []
    for side in features:
        begin, end = side.offsets[b : b + 2].tolist()
        rows.append(begin + side.valid[begin:end].nonzero()[:, 0])
    queries = rows[0][:: max(1, -(-len(rows[0]) // sample))]
    if len(queries) == 0 or len(rows[1]) == 0:
        return queries[:0], queries[:0], features[0].values.new_zeros(0)
    found = feature_nearest(features[0].values[queries], features[1].values[rows[1]], _NEAREST)
    count = min(_NEAREST, len(rows[1]))
    i, j = queries[:, None].expand(-1, count).flatten(), rows[1][found.row[:, :count].flatten()]
    return i, j, found.distance[:, :count].flatten().to(features[0].values)
