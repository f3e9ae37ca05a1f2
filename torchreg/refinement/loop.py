"""The iteration: match, update, match again, until fitness and inlier_rmse no longer change.

All pairs of a batch advance together; a pair that has converged or failed is no longer active.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.roots import square_root
from torchreg.geometry.se3 import apply_rotation
from torchreg.native import call, native
from torchreg.refinement.correspond import Correspondence
from torchreg.refinement.estimator import Estimator, MatchedBlocks
from torchreg.refinement.tree_search import addresses
from torchreg.types import Failure
from torchreg.types.packing import offsets_of

_NO_CORRESPONDENCES = Failure(
    "no correspondences", "no correspondences: no source point has a target point nearer than max_distance"
)
_OPEN_MOTION = Failure(
    "motion open", "the correspondences leave the motion open: too few, or all on a line, a plane or the like"
)
_OUTCOMES = ((False, None), (True, None), (False, _NO_CORRESPONDENCES), (False, _OPEN_MOTION))
"""Whether a pair converged and why it failed, by the numbers of compiled kernels."""


class Criteria(NamedTuple):
    """The numbers of every pair at one level."""

    max_distance: Tensor  # (B,) float64, meters
    kernel_scale: Tensor  # (B,) float64
    color_weight: Tensor  # (B,) float64
    iterations: Sequence[int]  # B numbers
    relative_fitness: Sequence[float]  # B numbers
    relative_rmse: Sequence[float]  # B numbers, meters


@dataclass(frozen=True, eq=False)
class State:
    """Transforms and progress of the pairs; its tensors and lists are written in place."""

    rotation: Tensor  # (B, 3, 3) float64, between the centered frames
    translation: Tensor  # (B, 3) float64, meters
    fitness: Tensor  # (B,) float64
    inlier_rmse: Tensor  # (B,) float64, meters
    iterations: list[int]  # B numbers, updates made
    converged: list[bool]  # B times whether
    failed: list[Failure | None]  # B times why a pair cannot go on, ``None`` where it can

    @staticmethod
    def start(T: Tensor, failed: list[Failure | None]) -> State:
        """The state before the first iteration, at transforms T (B, 4, 4)."""
        pairs = len(failed)
        return State(
            rotation=T[:, :3, :3].clone(),
            translation=T[:, :3, 3].clone(),
            fitness=T.new_zeros(pairs),
            inlier_rmse=T.new_zeros(pairs),
            iterations=[0] * pairs,
            converged=[False] * pairs,
            failed=failed,
        )

    def of(self, pairs: list[int]) -> State:
        """A copy of the state of some pairs."""
        parts: dict[str, Any] = {
            name: value[pairs] if isinstance(value, Tensor) else [value[b] for b in pairs]
            for name, value in vars(self).items()
        }
        return State(**parts)

    def write(self, pairs: list[int], part: State) -> None:
        """Write the state of some pairs back."""
        for name, values in vars(part).items():
            if isinstance(values, Tensor):
                getattr(self, name)[pairs] = values
            else:
                for b, value in zip(pairs, values, strict=True):
                    getattr(self, name)[b] = value


class ActivePairs:
    """The pairs still being refined.

    Attributes:
        matches: their correspondences.
        extra: (E, n, 256), what the estimator reads of source points beside their positions.
        lengths: (B,) float64, the numbers of source points of all pairs of the batch.
    """

    def __init__(self, matches: Correspondence, extra: Tensor, lengths: Tensor) -> None:
        """All pairs are active; their sources have ``lengths`` (B,) points."""
        self.matches, self.extra, self.lengths = matches, extra, lengths

    @property
    def pairs(self) -> list[int]:
        """The numbers of the active pairs."""
        return self.matches.pairs

    def keep(self, stays: list[bool]) -> None:
        """Keep some of the pairs."""
        if not all(stays):
            chosen = self.matches.keep([b for b, stay in enumerate(stays) if stay])
            self.extra = self.extra[:, chosen]

    def measure(self) -> tuple[Tensor, Tensor]:
        """Fitness and inlier_rmse (B,) of the active pairs."""
        matches = self.matches

        def terms(chunk: slice) -> Tensor:
            inside = matches.inside[chunk].double()
            return torch.stack([inside, inside * matches.apart(chunk)])

        count, total = matches.blocks.sums(terms, 2).unbind(1)
        return count / self.lengths[self.pairs], square_root(total / count.clamp_min(1))

    def sums(self, estimator: Estimator, criteria: Criteria, rotation: Tensor) -> Tensor:
        """The estimator's sums (B, C), where the sources are turned by ``rotation`` (B, 3, 3)."""
        matches = self.matches
        pair = torch.tensor(self.pairs, device=self.extra.device)[matches.blocks.pair]  # (n,)
        scale, color = criteria.kernel_scale[pair, None], criteria.color_weight[pair, None]  # (n, 1)

        def terms(chunk: slice) -> Tensor:
            return estimator.terms(
                MatchedBlocks(
                    moved=matches.moved[:3, chunk],
                    partner=matches.partner[:, chunk],
                    inside=matches.inside[chunk].double(),
                    extra=self.extra[:, chunk],
                    rotation=rotation[matches.blocks.pair[chunk]],
                    kernel_scale=scale[chunk],
                    color_weight=color[chunk],
                )
            )

        return matches.blocks.sums(terms, estimator.channels)


def iterate(active: ActivePairs, center: Tensor, estimator: Estimator, criteria: Criteria, state: State) -> None:
    """Refine all pairs of ``state`` in place, none of which has failed.

    ``active`` are all B pairs, not yet moved; ``center`` (B, 3) float64, meters, those of the targets.
    """
    trees = addresses(active.matches.target.search)
    if estimator.compiled and trees is not None and native(state.rotation):
        _iterate_compiled(estimator.compiled, active, trees, center, criteria, state)
        return
    active.matches.move(state.rotation, state.translation)
    state.fitness[:], state.inlier_rmse[:] = active.measure()
    _dismiss(active, (state.fitness > 0).tolist(), _NO_CORRESPONDENCES, state)
    updates = 0
    while active.pairs:
        update = estimator.solve(active.sums(estimator, criteria, state.rotation[active.pairs]), center[active.pairs])
        R = apply_rotation(update.rotation[:, None], state.rotation[active.pairs].transpose(1, 2)).transpose(1, 2)
        t = apply_rotation(update.rotation, state.translation[active.pairs]) + update.translation
        usable = update.usable & torch.isfinite(t).all(dim=1)
        _dismiss(active, usable.tolist(), _OPEN_MOTION, state)
        if active.pairs:
            updates += 1
            _advance(active, R[usable], t[usable], updates, criteria, state)


def _iterate_compiled(
    kernel: str, active: ActivePairs, trees: Tensor, center: Tensor, criteria: Criteria, state: State
) -> None:
    """As ``iterate``, by a kernel that makes all iterations; ``trees`` (B, 4) as ``addresses`` has them."""
    matches = active.matches
    rows = torch.tensor([state.iterations, criteria.iterations, [0] * len(trees), [0] * len(trees)])
    before, most, updates, outcome = rows.unbind(0)
    call(
        kernel,
        matches.source,
        matches.source.shape[1],
        offsets_of(matches.blocks.counts),
        active.lengths.long(),
        len(trees),
        trees,
        matches.target.values,
        matches.target.values.shape[1],
        torch.tensor(matches.target.first),
        center.contiguous(),
        criteria.max_distance,
        most,
        torch.tensor(criteria.relative_fitness, dtype=torch.float64),
        torch.tensor(criteria.relative_rmse, dtype=torch.float64),
        state.rotation,
        state.translation,
        state.fitness,
        state.inlier_rmse,
        updates,
        outcome,
    )
    state.iterations[:] = (before + updates).tolist()
    for b, number in enumerate(outcome.tolist()):
        state.converged[b], state.failed[b] = _OUTCOMES[number]


def _advance(active: ActivePairs, R: Tensor, t: Tensor, updates: int, criteria: Criteria, state: State) -> None:
    """Move the active pairs, store their state, and drop those that are done."""
    active.matches.move(R, t)
    fitness, rmse = active.measure()
    met = fitness > 0
    _dismiss(active, met.tolist(), _NO_CORRESPONDENCES, state)
    pairs, fitness, rmse = active.pairs, fitness[met], rmse[met]
    fitness_change = (fitness - state.fitness[pairs]).abs().tolist()
    rmse_change = (rmse - state.inlier_rmse[pairs]).abs().tolist()
    state.rotation[pairs], state.translation[pairs] = R[met], t[met]
    state.fitness[pairs], state.inlier_rmse[pairs] = fitness, rmse
    stays_active = []
    for b, of_fitness, of_rmse in zip(pairs, fitness_change, rmse_change, strict=True):
        state.iterations[b] += 1
        state.converged[b] = of_fitness < criteria.relative_fitness[b] and of_rmse < criteria.relative_rmse[b]
        stays_active.append(not state.converged[b] and updates < criteria.iterations[b])
    active.keep(stays_active)


def _dismiss(active: ActivePairs, stays: list[bool], failure: Failure, state: State) -> None:
    """Drop the pairs that cannot go on."""
    for b, stay in zip(active.pairs, stays, strict=True):
        if not stay:
            state.failed[b] = failure
    active.keep(stays)
