"""Where the matches of pairs come from: descriptors of the library, or features or matches from elsewhere.

``find_poses`` asks a ``Matching`` for matches, for those that may speak for a rival, and for a second look. What is
made of them (poses, the judgement on the clouds, refinement, probability, reasons) is the same for all, so features are
compared by what they propose alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import torch

from torchreg.matching.mutual import match_mutual
from torchreg.registration.described import DescribedClouds
from torchreg.registration.looks import second_look
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.recipes import Recipe, fused, outside_recipes, recipes_of
from torchreg.registration.rivals import NearMatches, nearest_matches
from torchreg.solvers.batch import poses_of_pairs
from torchreg.types import Correspondences, Features
from torchreg.types.packing import offsets_of
from torchreg.verification import ProposedPoses

COARSER = 2.0
"""How many times as far apart matched points may lie at the second look at features or matches from elsewhere."""

_NEAREST = 2  # rows that may match then


Mutual = Callable[[Features, Features, Recipe, RegistrationOptions], Correspondences]
"""Matches the features of a recipe mutually."""


class Matched(NamedTuple):
    """The matches of one recipe."""

    matches: Correspondences
    near: Callable[[], Sequence[NearMatches]]  # of every pair, those that may speak for a rival


class Matching(ABC):
    """Where the matches of the pairs of one slice come from."""

    @abstractmethod
    def recipes(self, source: DescribedClouds, options: RegistrationOptions, *, colored: bool) -> tuple[Recipe, ...]:
        """The recipes to try, the first before all others."""

    @abstractmethod
    def match(
        self,
        source: DescribedClouds,
        target: DescribedClouds,
        recipe: Recipe,
        options: RegistrationOptions,
        mutual: Mutual,
    ) -> Matched:
        """Match all pairs by a recipe, features by ``mutual``; pairs without points have no match."""

    @abstractmethod
    def look(
        self,
        b: int,
        source: DescribedClouds,
        target: DescribedClouds,
        options: RegistrationOptions,
        seed: int,
        before: Collection[str],
    ) -> list[ProposedPoses]:
        """Look again at pair ``b``, whose clouds are these; proposals of origins in ``before`` are not made again."""


class DescriptorMatching(Matching):
    """By the descriptors of the options, fused."""

    def recipes(self, source: DescribedClouds, options: RegistrationOptions, *, colored: bool) -> tuple[Recipe, ...]:
        """As ``recipes_of``."""
        return recipes_of(options, colored=colored)

    def match(
        self,
        source: DescribedClouds,
        target: DescribedClouds,
        recipe: Recipe,
        options: RegistrationOptions,
        mutual: Mutual,
    ) -> Matched:
        """Mutual nearest neighbors."""
        features = fused(source, recipe, options), fused(target, recipe, options)
        return _by_features(source, target, features, mutual(*features, recipe, options))

    def look(
        self,
        b: int,
        source: DescribedClouds,
        target: DescribedClouds,
        options: RegistrationOptions,
        seed: int,
        before: Collection[str],
    ) -> list[ProposedPoses]:
        """At other scales, supports and signs."""
        return second_look(source, target, options, seed, before)


class FeatureMatching(Matching):
    """By the features from elsewhere that the described clouds have."""

    def recipes(self, source: DescribedClouds, options: RegistrationOptions, *, colored: bool) -> tuple[Recipe, ...]:
        """As ``outside_recipes``, by the names of the blocks."""
        return outside_recipes(tuple(name for name, _ in _outside(source).blocks), options)

    def match(
        self,
        source: DescribedClouds,
        target: DescribedClouds,
        recipe: Recipe,
        options: RegistrationOptions,
        mutual: Mutual,
    ) -> Matched:
        """Mutual nearest neighbors."""
        features = _outside(source), _outside(target)
        return _by_features(source, target, features, mutual(*features, recipe, options))

    def look(
        self,
        b: int,
        source: DescribedClouds,
        target: DescribedClouds,
        options: RegistrationOptions,
        seed: int,
        before: Collection[str],
    ) -> list[ProposedPoses]:
        """Two nearest rows may match, at the inlier threshold and at twice that."""
        one, other = _outside(source), _outside(target)
        words = " + ".join(name for name, _ in one.blocks) + f", {_NEAREST} nearest"
        return _looked(source, target, match_mutual(one, other, neighbors=_NEAREST), words, options, seed, before)


class GivenMatching(Matching):
    """Matches from elsewhere.

    Args:
        matches: of every pair, rows of its own two clouds and scores.
    """

    def __init__(self, matches: Sequence[NearMatches]) -> None:
        self._matches = matches

    def recipes(self, source: DescribedClouds, options: RegistrationOptions, *, colored: bool) -> tuple[Recipe, ...]:
        """By the options' solver, at effort thorough by both of the library's."""
        every = outside_recipes(("matches",), options)
        return tuple(dict.fromkeys(recipe._replace(neighbors=1) for recipe in every))

    def match(
        self,
        source: DescribedClouds,
        target: DescribedClouds,
        recipe: Recipe,
        options: RegistrationOptions,
        mutual: Mutual,
    ) -> Matched:
        """The matches as they are."""
        firsts = zip(source.cloud.offsets.tolist(), target.cloud.offsets.tolist(), strict=True)
        lengths = zip(source.cloud.lengths, target.cloud.lengths, strict=True)
        placed = []
        for (i, j, score), first, sizes in zip(self._matches, list(firsts)[:-1], lengths, strict=True):
            kept = slice(0, None if min(sizes) > 0 else 0)
            placed.append(NearMatches(i[kept] + first[0], j[kept] + first[1], score[kept]))
        return Matched(_correspondences(placed), lambda: placed)

    def look(
        self,
        b: int,
        source: DescribedClouds,
        target: DescribedClouds,
        options: RegistrationOptions,
        seed: int,
        before: Collection[str],
    ) -> list[ProposedPoses]:
        """At twice the inlier threshold."""
        return _looked(source, target, _correspondences([self._matches[b]]), "matches", options, seed, before)


def _outside(side: DescribedClouds) -> Features:
    if side.outside is None:
        raise ValueError("outside: expected features of the described clouds, got none")
    return side.matched(side.outside)


def _by_features(
    source: DescribedClouds,
    target: DescribedClouds,
    features: tuple[Features, Features],
    matches: Correspondences,
) -> Matched:
    colored = source.cloud.colors is not None and target.cloud.colors is not None
    return Matched(matches, lambda: nearest_matches(features, colored=colored))


def _correspondences(matches: Sequence[NearMatches]) -> Correspondences:
    i, j, score = (torch.cat(column) for column in zip(*matches, strict=True))
    return Correspondences(i, j, offsets_of(len(part.source) for part in matches), score)


def _looked(
    source: DescribedClouds,
    target: DescribedClouds,
    matches: Correspondences,
    words: str,
    options: RegistrationOptions,
    seed: int,
    before: Collection[str],
) -> list[ProposedPoses]:
    """The poses of one pair by the same matches, solved at the inlier threshold and at twice that."""
    proposed = []
    for coarser in (1.0, COARSER):
        apart = f", {coarser:g} times as far apart" if coarser != 1 else ""
        origin = f"{words}{apart}, {options.solver.name}"
        if origin not in before:
            solver = options.solver.scaled(coarser).at_effort(options.effort)
            poses = poses_of_pairs(source.cloud, target.cloud, matches, [solver], seed=seed)
            proposed.append(ProposedPoses(origin, matches, poses, coarser))
    return proposed
