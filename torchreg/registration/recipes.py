"""Which features and solvers a registration tries: one recipe as the options say, or several that compete.

What one set of features blurs another may tell apart, so the poses of several sets are candidates together
(``torchreg.verification`` chooses among them). The sets share their descriptors: each is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch

from torchreg.matching import match_mutual
from torchreg.registration.describe import Described, fused
from torchreg.solvers import CompatibilityOptions, PairPoses, RansacOptions, Solver, base_seed, poses_of_pairs
from torchreg.types import Clouds, Correspondences, RegistrationOptions

_FURTHER_SETS = ((("contrast",), (0.8,)), (("pcfh",), (0.5,)))


COARSER = 1.5
"""By how much ``effort="fast"`` widens the spacing of the points."""

_THRESHOLD_SPACINGS = 1.5  # the default inlier threshold, in spacings


class Recipe(NamedTuple):
    """One way from descriptors to poses.

    Attributes:
        color: blocks beside FPFH.
        weights: of these blocks, FPFH's being 1.
        neighbors: nearest rows that may match.
        solver: ``"ransac"`` or ``"compatibility"``.
    """

    color: tuple[str, ...]
    weights: tuple[float, ...]
    neighbors: int
    solver: str

    @property
    def words(self) -> str:
        """The recipe's name, such as "fpfh + contrast, 2 nearest, compatibility"."""
        several = f", {self.neighbors} nearest" if self.neighbors > 1 else ""
        return " + ".join(("fpfh", *self.color)) + f"{several}, {self.solver}"


def coarser(options: RegistrationOptions) -> RegistrationOptions:
    """The options on points ``COARSER`` times as far apart: every length grows, and voxels thin the clouds."""
    voxel = max(options.voxel_size or 0.0, options.ransac.inlier_threshold / _THRESHOLD_SPACINGS)
    threshold = COARSER * options.ransac.inlier_threshold
    return replace(
        options,
        voxel_size=COARSER * voxel,
        normal_radius=COARSER * options.normal_radius,
        feature_radius=COARSER * options.feature_radius,
        color_radius=COARSER * options.color_radius,
        ransac=replace(options.ransac, inlier_threshold=threshold),
    )


def recipes_of(options: RegistrationOptions, colored: bool) -> tuple[Recipe, ...]:
    """What to try, the options' own recipe first; without colors the geometry alone."""
    color, weights = (options.color, options.color_weights) if colored else ((), ())
    own = Recipe(color, weights, options.match_neighbors, options.solver)
    geometry = own._replace(color=(), weights=())
    if options.effort in ("plain", "fast"):
        return (own,)
    if options.effort == "balanced":
        return tuple(dict.fromkeys((own, geometry)))
    several = own.neighbors if options.ratio is not None else max(own.neighbors, 2)
    sets = dict.fromkeys([own[:2], geometry[:2], *(_FURTHER_SETS if color else ())])
    tried = [
        Recipe(names, shares, neighbors, solver)
        for names, shares in sets
        for neighbors, solver in ((several, "compatibility"), (own.neighbors, "ransac"))
    ]
    return tuple(dict.fromkeys((own, *tried)))


def blocks_of(recipes: Sequence[Recipe]) -> tuple[str, ...]:
    """The color blocks that some recipe needs."""
    return tuple(dict.fromkeys(name for recipe in recipes for name in recipe.color))


def match(
    source: Described, target: Described, recipe: Recipe, ratio: float | None, root: float = 0.0
) -> Correspondences:
    """Mutual matches of one recipe's features."""
    one, other = (fused(side, recipe.color, recipe.weights, root) for side in (source, target))
    return match_mutual(one, other, ratio=ratio, neighbors=recipe.neighbors)


def solve(
    source: Clouds,
    target: Clouds,
    matches: Correspondences,
    recipe: Recipe,
    options: Sequence[RegistrationOptions],
    seed: int,
) -> list[PairPoses]:
    """Distinct poses of every pair by one recipe's solver."""
    drawn = base_seed(torch.Generator().manual_seed(seed))
    return poses_of_pairs(source, target, matches, solvers_of(recipe.solver, options), drawn)


def solvers_of(name: str, options: Sequence[RegistrationOptions]) -> list[Solver]:
    """The solver of this name for every pair."""
    if name == RansacOptions.name:
        return [option.ransac for option in options]
    return [
        CompatibilityOptions(
            inlier_threshold=option.ransac.inlier_threshold, local_optimization=option.ransac.local_optimization
        ).at_effort(option.effort)
        for option in options
    ]
