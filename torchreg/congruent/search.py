"""The search of one pair: bases of the source, congruent sets in the target, poses, the best of them refined."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.congruent.bases import draw_bases
from torchreg.congruent.options import Super4pcsOptions
from torchreg.congruent.pairs import found_pairs, pair_table, rarest
from torchreg.congruent.poses import CommonPoints, ScoredPoses, distinct, joined, no_poses, poses_of_sets
from torchreg.congruent.sets import congruent_sets
from torchreg.congruent.sides import CloudSide, Tolerances, diameter, side_of
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.refinement.icp import refine_pairs
from torchreg.refinement.options import IcpOptions
from torchreg.refinement.pairing import Pairing
from torchreg.solvers.poses import APART, POSES, PairPoses, no_pose
from torchreg.types import Clouds, Failure

_DRAWN = 4  # bases drawn for one that is looked for
_ROUND = 16  # bases that are looked for together
_ENOUGH = 0.5  # mean worth of a point with a partner: a pose with a partner for the assumed overlap ends the search
_REACH = 2.0  # tolerances within which ICP takes partners
_ITERATIONS = 15


class _Counts(NamedTuple):
    """What a search came across."""

    bases: int
    sets: int
    poses: int


def search_pair(
    source: Clouds, target: Clouds, options: Super4pcsOptions, spacing: float, seed: int, *, signed: bool
) -> PairPoses:
    """The distinct poses of one pair, best first, between the frames of the points; they come without matches.

    Args:
        source: one cloud with normals, thinned.
        target: likewise.
        options: how to search.
        spacing: meters, of their points.
        seed: of the bases.
        signed: whether the signs of normals are known on both sides.
    """
    one, other = side_of(source), side_of(target)
    within = Tolerances(
        meters=options.threshold * spacing,
        normals=math.radians(options.normal_degrees),
        colors=math.inf if options.color_distance is None else options.color_distance,
        signed=signed,
    )
    counter = CommonPoints(one, other, within)
    poses, counts = _searched(one, other, options, within, counter, torch.Generator().manual_seed(seed))
    if len(poses.score) == 0:
        text = (
            f"no hypothesis left: of {counts.bases} bases {counts.sets} congruent sets were found, "
            f"and none gave a transform"
        )
        figures = {"bases": counts.bases, "sets": counts.sets}
        failure = Failure("no hypothesis", text, figures)
        return no_pose(0, source.device, failure, counts.bases, counts.sets)
    poses = distinct(poses, one, APART * within.meters, POSES)
    poses = distinct(_refined(poses, one, other, within, counter), one, APART * within.meters, POSES)
    rotation = poses.rotation.permute(2, 0, 1).contiguous()
    translation = poses.translation.t() + other.center - apply_rotation(rotation, one.center.expand(len(rotation), 3))
    none = torch.zeros(len(rotation), dtype=torch.float64, device=source.device)
    return PairPoses(
        rotation=rotation,
        translation=translation,
        inliers=torch.zeros(len(rotation), 0, dtype=torch.bool, device=source.device),
        support=none.long(),
        error=none,
        drawn=counts.bases,
        kept=counts.sets,
        scored=counts.poses,
        failure=None,
    )


def _searched(
    source: CloudSide,
    target: CloudSide,
    options: Super4pcsOptions,
    within: Tolerances,
    counter: CommonPoints,
    generator: torch.Generator,
) -> tuple[ScoredPoses, _Counts]:
    """The best poses of all bases, or of as many as it takes to find the assumed overlap."""
    widest = options.overlap * diameter(source)
    drawn = draw_bases(source, _DRAWN * options.bases, widest, within.meters / 2, generator)
    table = pair_table(target, within.meters, widest + within.meters)
    bases = rarest(table, source, target, drawn, within, options.bases)
    best, counts = no_poses(source.points.device), _Counts(0, 0, 0)
    for begin in range(0, bases.corners.shape[1], _ROUND):
        part = bases.take(slice(begin, begin + _ROUND))
        pairs = [found_pairs(table, source, target, part, diagonal, within) for diagonal in range(2)]
        sets = congruent_sets(source, target, part, (pairs[0], pairs[1]), within.meters)
        poses, found, fitting = poses_of_sets(source, target, part, sets, within, counter)
        best = joined(best, counter.exactly(poses))
        counts = _Counts(counts.bases + part.corners.shape[1], counts.sets + found, counts.poses + fitting)
        if len(best.score) > 0 and float(best.score.amax()) >= _ENOUGH * options.overlap:
            break
    return best, counts


def _refined(
    poses: ScoredPoses, source: CloudSide, target: CloudSide, within: Tolerances, counter: CommonPoints
) -> ScoredPoses:
    """The poses after ICP, each as it was where that lowers its score."""
    number = len(poses.score)
    clouds = [Clouds(points=side.points.t(), normals=_rows(side.normals)) for side in (source, target)]
    kind = "point_to_point" if target.normals is None else "point_to_plane"
    result = refine_pairs(
        clouds[0],
        clouds[1],
        Pairing([0] * number, [0] * number),
        rigid(poses.rotation.permute(2, 0, 1), poses.translation.t()),
        [IcpOptions(kind=kind, max_distance=_REACH * within.meters, iterations=_ITERATIONS)] * number,
    )
    T = result.T_target_source
    moved = ScoredPoses(T[:, :3, :3].permute(1, 2, 0).contiguous(), T[:, :3, 3].t().contiguous(), poses.score)
    moved = counter.exactly(moved)
    rows = torch.arange(number, device=poses.score.device)
    return joined(poses, moved).take(torch.where(moved.score > poses.score, rows + number, rows))


def _rows(columns: Tensor | None) -> Tensor | None:
    return None if columns is None else columns.t().contiguous()
