"""The record of a solver: its options, and how it gets from the matches of a pair to hypotheses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.errors import at_least, expect, expect_in_words, one_of, positive
from torchreg.solvers.points import MatchedPoints
from torchreg.solvers.scoring import QUALITIES, correspondence_vectors, proposal_dtype, propose_counts
from torchreg.types import Failure
from torchreg.types.lengths import length, scaled
from torchreg.types.loading import loadable

AnySolver = TypeVar("AnySolver", bound="Solver")

_STORED = 1 << 17


class Hypotheses:
    """Hypotheses of one pair, ranked by their proposed inlier counts, ties to the earlier one.

    Attributes:
        source: (3, M) matched points in the dtype that hypotheses are proposed in, about their mean, meters.
        target: (3, M) likewise.
        drawn: how many hypotheses were begun, such as samples drawn or seeds of sets.
        kept: of those, how many passed the solver's first test.
        total: of those, how many were added, and so scored on all correspondences.
        stored: how many are kept in memory; of very many, those with the lowest counts are dropped.
        explanation: why none was added, in words that follow "no hypothesis left: ".

    Example:
        >>> import torch, torchreg as tr
        >>> from torchreg.solvers import Hypotheses, MatchedPoints
        >>> points = torch.rand(3, 20, dtype=torch.float64)  # axes first
        >>> hypotheses = Hypotheses(MatchedPoints(points, points, torch.zeros(20), seed=0), threshold=0.1)
        >>> hypotheses.add(torch.eye(3, dtype=torch.float64)[:, :, None], torch.zeros(3, 1, dtype=torch.float64))
        tensor([20.])
    """

    def __init__(self, points: MatchedPoints, threshold: float) -> None:
        dtype = proposal_dtype(points.source, points.target, threshold)
        self.source, self.target = points.source.to(dtype), points.target.to(dtype)
        self.drawn = self.kept = self.total = self.stored = 0
        self.explanation = ""
        self._threshold = threshold
        self._vectors = correspondence_vectors(self.source, self.target)
        self._rotation = [self.source.new_empty(3, 3, 0)]
        self._translation = [self.source.new_empty(3, 0)]
        self._key = [torch.empty(0, dtype=torch.int64, device=self.source.device)]

    @property
    def dtype(self) -> torch.dtype:
        """float32, or float64 where the threshold is small beside the points' extent."""
        return self.source.dtype

    @property
    def failure(self) -> Failure | None:
        """Why there is no hypothesis, ``None`` where there is one."""
        if self.total > 0:
            return None
        text = self.explanation or f"of {self.drawn} begun {self.kept} passed the first test, and none gave a transform"
        figures = {"drawn": self.drawn, "kept": self.kept}
        return Failure("no hypothesis", f"no hypothesis left: {text}", figures)

    def add(self, rotation: Tensor, translation: Tensor) -> Tensor:
        """Enter hypotheses (3, 3, H), (3, H): x_target = R x_source + t in the frames of the points.

        Returns:
            (H,) proposed inlier counts: exact but for residuals within rounding of the threshold.
        """
        rotation, translation = rotation.to(self.dtype), translation.to(self.dtype)
        proposed = propose_counts(rotation, translation, self._vectors, self._threshold)
        number = torch.arange(self.total, self.total + len(proposed), device=proposed.device)
        self._rotation.append(rotation)
        self._translation.append(translation)
        self._key.append(proposed.long() * (1 << 40) - number)  # distinct, so that their order is one only
        self.total += len(proposed)
        self.stored += len(proposed)
        if self.stored > 2 * _STORED:
            self._rotation, self._translation, self._key = ([part] for part in self._top(_STORED))
            self.stored = _STORED
        return proposed

    def best(self, count: int) -> tuple[Tensor, Tensor]:
        """Rotations (3, 3, F) and translations (3, F), best first."""
        return self._top(count)[:2]

    def _top(self, count: int) -> tuple[Tensor, Tensor, Tensor]:
        key = torch.cat(self._key)
        top = key.topk(min(count, len(key))).indices
        return torch.cat(self._rotation, dim=-1)[..., top], torch.cat(self._translation, dim=-1)[:, top], key[top]


@checked_record
@dataclass(frozen=True, kw_only=True)
class Solver:
    """How matches become poses. To add a solver is to write a subclass with a ``name`` and ``propose``.

    Its hypotheses are scored on all matches of the pair, refitted to their inliers, thinned to distinct poses and
    tested against chance by code that all solvers share.

    Attributes:
        name: of the solver, in options, tables and ``SOLVERS``.
        inlier_threshold: meters; a correspondence farther apart than this after the transform is an outlier.
        local_optimization: rounds of refitting to the inliers of the best hypotheses; 0 keeps them as proposed.
        scoring: how transforms are compared: by the ``"count"`` of inliers, or by ``"msac"``, where an inlier counts
            for 1 - (residual / threshold)^2.

    Example:
        >>> from dataclasses import dataclass
        >>> import torchreg as tr
        >>> from torchreg.solvers import Hypotheses, MatchedPoints, Solver
        >>> @dataclass(frozen=True, kw_only=True)
        ... class FitToAll(Solver):
        ...     name = "fit to all"
        ...     def propose(self, points: MatchedPoints) -> Hypotheses:
        ...         hypotheses = Hypotheses(points, self.inlier_threshold)
        ...         T = tr.kabsch(points.source.t(), points.target.t())
        ...         hypotheses.drawn = hypotheses.kept = 1
        ...         hypotheses.add(T[:3, :3, None], T[:3, 3, None])
        ...         return hypotheses
    """

    name: ClassVar[str]

    inlier_threshold: float = length(0.2)
    local_optimization: int = 10
    scoring: str = "msac"

    def __init_subclass__(cls, **more: Any) -> None:  # noqa: ANN401
        """Let results that hold such a record be loaded by ``torch.load`` as they are."""
        super().__init_subclass__(**more)
        loadable(cls)

    def __post_init__(self) -> None:
        positive(self.inlier_threshold, "inlier_threshold")
        at_least(self.local_optimization, "local_optimization", 0)
        one_of(self.scoring, "scoring", tuple(QUALITIES))

    @property
    def least_matches(self) -> int:
        """Matches that fix a transform: a pair with fewer fails, and as many fit a hypothesis by construction."""
        return 3

    def scaled(self: AnySolver, factor: float) -> AnySolver:
        """The solver for clouds whose lengths are ``factor`` times as great."""
        return scaled(self, factor)

    def at_effort(self: AnySolver, effort: str) -> AnySolver:
        """The solver as ``register`` runs it at this effort."""
        return self

    def tests(self, scored: int) -> float:
        """How many hypotheses the verdict takes to have been tried, when ``scored`` were; at most one per sample.

        Infinite where hypotheses are the choice among all samples, as those of any solver that does not draw blindly.
        """
        return math.inf

    def propose(self, points: MatchedPoints) -> Hypotheses:
        """The hypotheses of one pair, at least ``least_matches`` matches, all of finite points.

        Whatever is drawn at random is to follow from ``points.seed``.
        """
        raise NotImplementedError(f"{type(self).__name__} proposes nothing")

    @classmethod
    def propose_all(
        cls: type[AnySolver], solvers: Sequence[AnySolver], points: Sequence[MatchedPoints]
    ) -> Iterator[Hypotheses]:
        """The hypotheses of several pairs, in order, each by its solver; overridden where together takes less time."""
        name = f"{cls.__name__}.propose"
        for solver, pair in zip(solvers, points, strict=True):
            hypotheses = solver.propose(pair)
            expect(isinstance(hypotheses, Hypotheses), name, "Hypotheses", hypotheses)
            finite = all(bool(torch.isfinite(part).all()) for part in hypotheses.best(hypotheses.stored))
            expect_in_words(finite, name, "finite rotations and translations", "NaN or infinity")
            yield hypotheses
