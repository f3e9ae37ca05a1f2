"""The choice among candidates: weigh all, refine the best, look for what the solvers did not find, weigh again."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.refinement import IcpOptions, icp
from torchreg.types import Clouds
from torchreg.verification.information import Slide, information_matrix, slide
from torchreg.verification.model import probabilities
from torchreg.verification.poses import Poses, distinct, joined
from torchreg.verification.probes import flips, slides
from torchreg.verification.weigh import Scales, Weighed, weigh, weighed_together

APART = 6.0
"""Poses that move the source by more thresholds than this (root mean square) are distinct; ICP bridges less."""

_HOPELESS = 5.0  # log-odds below the best at which a probe is not worth refining
_ICP_POINTS = 600


class Chosen(NamedTuple):
    """The candidates of one pair, distinct, best first, and how firmly the best is held.

    Attributes:
        candidates: H distinct poses, H > 0.
        probability: (H,) float64.
        information: (6, 6) float64 of the best pose, Open3D's convention, in the frame of the target's file.
        slide: its weakest motion.
    """

    candidates: Weighed
    probability: Tensor
    information: Tensor
    slide: Slide


def choose(scales: Scales, poses: Poses, refine: int, iterations: int) -> Chosen:
    """Choose among the poses (H > 0) of one pair.

    Args:
        scales: what they are weighed on.
        poses: in order of their proposals, best first within each.
        refine: how many distinct ones are refined by ICP.
        iterations: of ICP, at most.
    """
    found = _sorted_out(scales, weigh(scales, poses))
    refined = _refined(scales, found.take(torch.arange(min(refine, len(found.odds)))), iterations)
    found = _sorted_out(scales, weighed_together([refined, found]))
    information, weakest = _hold(scales, found)
    best = found.poses.take(torch.zeros(1, dtype=torch.int64, device=found.odds.device))
    others = scales.target.points[scales.target.sample]
    probes = weigh(scales, joined([slides(best, weakest, scales.threshold), flips(best, others)]))
    worth = (probes.odds > found.odds[0] - _HOPELESS).nonzero()[:, 0]
    if len(worth) > 0:
        found = _sorted_out(scales, weighed_together([found, _refined(scales, probes.take(worth), iterations)]))
        information, weakest = _hold(scales, found)
    return Chosen(found, probabilities(found.odds), information, weakest)


def _sorted_out(scales: Scales, found: Weighed) -> Weighed:
    """Best first, without poses that repeat a better one; what a solver found as well is not called a probe."""
    ordered = found.best_first()
    moved = scales.source.points[scales.source.sample]
    apart = APART * scales.threshold
    kept = distinct(ordered.poses, moved, apart)
    vectors = ordered.poses.vectors(moved)  # (12, H)
    origin = ordered.poses.origin
    names = []
    for row in kept.tolist():
        close = (vectors - vectors[:, row, None]).square().sum(dim=0) <= apart * apart
        solved = origin[close & (origin >= 0)]
        names.append(solved[0] if int(origin[row]) < 0 and len(solved) > 0 else origin[row])
    best = ordered.take(kept)
    return best._replace(poses=best.poses._replace(origin=torch.stack(names)))


def _refined(scales: Scales, found: Weighed, iterations: int) -> Weighed:
    """The poses after ICP, each as it was where that speaks less for it."""
    count = len(found.odds)
    source, target = scales.source, scales.target
    rows = torch.arange(min(_ICP_POINTS, len(source.points)), device=source.points.device)
    rows = rows * len(source.points) // len(rows)
    moving = Clouds(points=source.points[rows])
    fixed = Clouds(points=target.points, normals=target.normals)
    options = IcpOptions(kind="point_to_plane", max_distance=scales.threshold, iterations=iterations)
    tried = icp(moving.select([0] * count), fixed.select([0] * count), found.poses.matrices(), options)
    after = weigh(scales, found.poses.moved(tried.T_target_source))
    better = after.odds > found.odds
    rows = torch.where(
        better, torch.arange(count, device=better.device) + count, torch.arange(count, device=better.device)
    )
    return weighed_together([found, after]).take(rows)


def _hold(scales: Scales, found: Weighed) -> tuple[Tensor, Slide]:
    """Information matrix and weakest motion of the first pose."""
    source, target = scales.source, scales.target
    R, t = found.poses.rotation[0], found.poses.translation[0]
    moved = (apply_rotation(R, source.points[source.sample].double()) + t).float()
    near = target.tree.nearest(moved)
    rows = near.index[near.sq_distance < scales.threshold**2]
    points = target.points[rows]
    normals = torch.zeros_like(points) if target.normals is None else target.normals[rows]
    share = len(source.points) / max(1, len(source.sample))
    return information_matrix(points.double() + target.origin) * share, slide(points, normals)
