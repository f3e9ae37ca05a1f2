"""The choice among candidates: weigh all, refine the best, look for what the solvers did not find, weigh again.

All pairs of a group take every step together. What is decided for a pair depends on that pair alone.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.verification.held import held, information, slide
from torchreg.verification.information import Slide
from torchreg.verification.moments import frames, moments
from torchreg.verification.poses import Poses, distinct, joined, runs_of
from torchreg.verification.probes import flips, slides
from torchreg.verification.refined import Finer
from torchreg.verification.weigh import Scales, Weighed, weigh, weighed_together

APART = 6.0
"""Poses that move the source by more thresholds than this (root mean square) are distinct; ICP bridges less."""

_HOPELESS = 5.0  # log-odds below the best at which a probe is not worth refining


class Choice(NamedTuple):
    """The candidates of G pairs and how firmly the best of each is held.

    Attributes:
        candidates: of all pairs, distinct, those of each pair best first; at least one each.
        information: (G, 6, 6) float64 of the best poses, Open3D's convention, in the frames of the targets' files.
        slide: their weakest motions.
    """

    candidates: Weighed
    information: Tensor
    slide: Slide


def choose(scales: Scales, poses: Poses, refine: int, iterations: int) -> Choice:
    """Choose among the poses of every pair.

    Args:
        scales: what they are weighed on.
        poses: at least one of every pair; pair by pair, in order of their proposals, best first within each.
        refine: how many distinct ones of a pair are refined by ICP.
        iterations: of ICP, at most.
    """
    span, target = frames(moments(scales.source)), moments(scales.target)
    finer = Finer(scales, iterations)
    found = _sorted_out(scales, span, weigh(scales, poses))
    foremost = [row for _, begin, end in runs_of(found.poses.pair) for row in range(begin, min(end, begin + refine))]
    found = _sorted_out(scales, span, weighed_together([finer.refined(found.take(_rows(found, foremost))), found]))
    best = _best(found)
    surfaces = held(scales, best.poses)
    weakest = slide(surfaces)
    probes = joined([slides(best.poses, weakest, scales.threshold), flips(best.poses, target)])
    tried = weigh(scales, probes.take(probes.pair.sort(stable=True).indices))
    worth = (tried.odds > best.odds[tried.poses.pair] - _HOPELESS).nonzero()[:, 0]
    if len(worth) > 0:
        found = _sorted_out(scales, span, weighed_together([found, finer.refined(tried.take(worth))]))
        surfaces = held(scales, _best(found).poses)
        weakest = slide(surfaces)
    return Choice(found, information(scales, surfaces), weakest)


def _best(found: Weighed) -> Weighed:
    """The first of every pair."""
    return found.take(_rows(found, [begin for _, begin, _ in runs_of(found.poses.pair)]))


def _rows(found: Weighed, rows: list[int]) -> Tensor:
    return torch.tensor(rows, dtype=torch.int64, device=found.odds.device)


def _sorted_out(scales: Scales, span: Tensor, found: Weighed) -> Weighed:
    """Best first, without poses that repeat a better one; what a solver found as well is not called a probe."""
    ordered = found.best_first()
    apart = APART * scales.threshold
    vectors = ordered.poses.vectors(span)  # (12, H)
    rows = distinct(vectors, ordered.poses.pair, apart)
    kept = _rows(ordered, rows)
    best = ordered.take(kept)
    origin = best.poses.origin.clone()
    runs = {run.pair: run for run in runs_of(ordered.poses.pair)}
    for place in (origin < 0).nonzero()[:, 0].tolist():
        pair, begin, end = runs[int(best.poses.pair[place])]
        own, names = vectors[:, begin:end], ordered.poses.origin[begin:end]
        close = (own - vectors[:, rows[place], None]).square().sum(dim=0) <= apart[pair].square()
        solved = names[close & (names >= 0)]
        origin[place] = solved[0] if len(solved) > 0 else origin[place]
    return best._replace(poses=best.poses._replace(origin=origin))
