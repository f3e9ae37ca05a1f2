"""The iteration: match, update, match again, until fitness and inlier_rmse stand still.

All pairs of a batch advance together; a pair that has converged or failed leaves the work.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation
from torchreg.refinement.correspond import Correspondence
from torchreg.refinement.estimator import Estimator, Matched

NO_CORRESPONDENCES = "no correspondences: no source point has a target point nearer than max_distance"
OPEN_MOTION = "the correspondences leave the motion open: too few, or all on a line, a plane or the like"


class Criteria(NamedTuple):
    """The numbers of every pair at one level.

    Attributes:
        max_distance: (B,) float64, meters.
        kernel_scale: (B,) float64.
        color_weight: (B,) float64.
        iterations: B numbers.
        relative_fitness: B numbers.
        relative_rmse: B numbers, meters.
    """

    max_distance: Tensor
    kernel_scale: Tensor
    color_weight: Tensor
    iterations: Sequence[int]
    relative_fitness: Sequence[float]
    relative_rmse: Sequence[float]


@dataclass(frozen=True, eq=False)
class State:
    """Where the pairs stand; its tensors and lists are written in place.

    Attributes:
        rotation: (B, 3, 3) float64, between the centered frames.
        translation: (B, 3) float64, meters, likewise.
        fitness: (B,) float64.
        inlier_rmse: (B,) float64, meters.
        iterations: B numbers, updates made.
        converged: B times whether.
        failed: B reasons why a pair cannot go on, empty where it can.
    """

    rotation: Tensor
    translation: Tensor
    fitness: Tensor
    inlier_rmse: Tensor
    iterations: list[int]
    converged: list[bool]
    failed: list[str]


class Work:
    """The pairs still at work: their correspondences, what else is known of their points, their numbers.

    Attributes:
        matches: the correspondences of those pairs.
        extra: (E, n, 256), what the estimator knows of source points beside their place.
    """

    def __init__(self, matches: Correspondence, extra: Tensor, lengths: Tensor) -> None:
        """Begin with all pairs, whose sources have ``lengths`` (B,) points."""
        self.matches, self.extra, self._lengths = matches, extra, lengths

    @property
    def pairs(self) -> list[int]:
        """The numbers of the pairs at work."""
        return self.matches.pairs

    def keep(self, stays: list[bool]) -> None:
        """Go on with some of the pairs."""
        if not all(stays):
            chosen = self.matches.keep([b for b, stay in enumerate(stays) if stay])
            self.extra = self.extra[:, chosen]

    def measure(self) -> tuple[Tensor, Tensor]:
        """Fitness and inlier_rmse (B,) of the pairs at work."""
        matches = self.matches

        def terms(chunk: slice) -> Tensor:
            inside = matches.inside[chunk].double()
            return torch.stack([inside, inside * matches.square[chunk]])

        count, total = matches.blocks.sums(terms, 2).unbind(1)
        return count / self._lengths[self.pairs], (total / count.clamp_min(1)).sqrt()

    def sums(self, estimator: Estimator, criteria: Criteria) -> Tensor:
        """The estimator's sums (B, C)."""
        matches = self.matches
        pair = torch.tensor(self.pairs, device=self.extra.device)[matches.blocks.pair]  # (n,)
        scale, color = criteria.kernel_scale[pair, None], criteria.color_weight[pair, None]  # (n, 1)

        def terms(chunk: slice) -> Tensor:
            return estimator.terms(
                Matched(
                    moved=matches.moved[:, chunk],
                    partner=matches.partner[:, chunk],
                    inside=matches.inside[chunk].double(),
                    extra=self.extra[:, chunk],
                    kernel_scale=scale[chunk],
                    color_weight=color[chunk],
                )
            )

        return matches.blocks.sums(terms, estimator.channels)


def iterate(work: Work, center: Tensor, estimator: Estimator, criteria: Criteria, state: State) -> None:
    """Refine all pairs of ``state``, none of which has failed.

    Args:
        work: all B pairs, not yet moved.
        center: (B, 3) float64, meters, the targets' centers.
        estimator: the kind of ICP.
        criteria: when to stop.
        state: where the pairs start from; in the end, where they stand.
    """
    work.matches.move(state.rotation, state.translation)
    state.fitness[:], state.inlier_rmse[:] = work.measure()
    _dismiss(work, (state.fitness > 0).tolist(), NO_CORRESPONDENCES, state)
    made = 0
    while work.pairs:
        update = estimator.solve(work.sums(estimator, criteria), center[work.pairs])
        R = apply_rotation(update.rotation[:, None], state.rotation[work.pairs].transpose(1, 2)).transpose(1, 2)
        t = apply_rotation(update.rotation, state.translation[work.pairs]) + update.translation
        usable = update.usable & torch.isfinite(t).all(dim=1)
        _dismiss(work, usable.tolist(), OPEN_MOTION, state)
        if work.pairs:
            made += 1
            _advance(work, R[usable], t[usable], made, criteria, state)


def _advance(work: Work, R: Tensor, t: Tensor, made: int, criteria: Criteria, state: State) -> None:
    """Move the pairs at work, write down where they stand, and let go those that are done."""
    work.matches.move(R, t)
    fitness, rmse = work.measure()
    met = fitness > 0
    _dismiss(work, met.tolist(), NO_CORRESPONDENCES, state)
    pairs, fitness, rmse = work.pairs, fitness[met], rmse[met]
    fitness_change = (fitness - state.fitness[pairs]).abs().tolist()
    rmse_change = (rmse - state.inlier_rmse[pairs]).abs().tolist()
    state.rotation[pairs], state.translation[pairs] = R[met], t[met]
    state.fitness[pairs], state.inlier_rmse[pairs] = fitness, rmse
    goes_on = []
    for b, of_fitness, of_rmse in zip(pairs, fitness_change, rmse_change, strict=True):
        state.iterations[b] += 1
        state.converged[b] = of_fitness < criteria.relative_fitness[b] and of_rmse < criteria.relative_rmse[b]
        goes_on.append(not state.converged[b] and made < criteria.iterations[b])
    work.keep(goes_on)


def _dismiss(work: Work, stays: list[bool], reason: str, state: State) -> None:
    """Let the pairs go that cannot go on."""
    for b, stay in zip(work.pairs, stays, strict=True):
        if not stay:
            state.failed[b] = reason
    work.keep(stays)
