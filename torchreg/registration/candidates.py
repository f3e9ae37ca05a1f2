"""From two described sides to the result: which sets of features and which solvers compete, their poses, the choice.

Points that look alike in one set of features may differ in another, so the poses of several sets are candidates
together, and ``torchreg.verification`` chooses among them. The sets share their descriptors: each is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch

from torchreg.descriptors.fuse import fuse, rooted
from torchreg.matching.mutual import match_mutual
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.stopwatch import stage
from torchreg.solvers import base_seed, result_of_poses
from torchreg.solvers.batch import poses_of_pairs
from torchreg.types import Correspondences, Features, RegistrationResult
from torchreg.verification import WORK, PairLengths, ProposedPoses
from torchreg.verification.verify import verify


class Recipe(NamedTuple):
    """One way from descriptors to poses."""

    blocks: tuple[int, ...]  # numbers of the descriptors that are fused
    names: tuple[str, ...]  # of these descriptors
    weights: tuple[float, ...]  # of these descriptors
    neighbors: int  # nearest rows that may match
    solver: str  # its name

    @property
    def origin(self) -> str:
        """The recipe in words, such as "fpfh + contrast, 2 nearest, compatibility"."""
        several = f", {self.neighbors} nearest" if self.neighbors > 1 else ""
        return " + ".join(self.names) + f"{several}, {self.solver}"


def recipes_of(options: RegistrationOptions, *, colored: bool) -> tuple[Recipe, ...]:
    """The recipes to try, that of the options first; without colors, blocks that need them are left out.

    Plain and fast try that one alone; balanced also the geometry by itself; thorough each color block beside the
    geometry too, and all of these both by compatibility with two nearest neighbors and by RANSAC.
    """
    blocks = [
        block
        for block in zip(options.descriptors, options.weights, strict=True)
        if colored or not block[0].needs_colors
    ]
    everything = tuple(range(len(blocks)))
    color = [number for number in everything if blocks[number][0].needs_colors]
    geometry = tuple(number for number in everything if number not in color)

    def recipe(numbers: tuple[int, ...], neighbors: int, solver: str) -> Recipe:
        names = tuple(blocks[number][0].name for number in numbers)
        return Recipe(numbers, names, tuple(blocks[number][1] for number in numbers), neighbors, solver)

    first = recipe(everything, options.match_neighbors, options.solver.name)
    if options.effort in ("plain", "fast"):
        return (first,)
    sets = [everything, geometry] if geometry else [everything]
    if options.effort == "balanced":
        return tuple(dict.fromkeys(recipe(numbers, first.neighbors, first.solver) for numbers in sets))
    sets += [tuple(sorted((*geometry, number))) for number in color]
    several = first.neighbors if options.ratio is not None else max(first.neighbors, 2)
    ways = ((several, "compatibility"), (first.neighbors, "ransac"))
    return tuple(dict.fromkeys((first, *(recipe(numbers, *way) for numbers in dict.fromkeys(sets) for way in ways))))


@stage("matching")
def match(
    source: DescribedClouds, target: DescribedClouds, recipe: Recipe, options: RegistrationOptions
) -> Correspondences:
    """Fuse the recipe's blocks and match them mutually."""
    return match_mutual(
        fused(source, recipe, options),
        fused(target, recipe, options),
        ratio=options.ratio,
        neighbors=recipe.neighbors,
    )


@stage("hypotheses")
def solve(
    source: DescribedClouds,
    target: DescribedClouds,
    matches: Correspondences,
    recipe: Recipe,
    options: Sequence[RegistrationOptions],
    seed: int,
) -> ProposedPoses:
    """Turn matches into the distinct poses of every pair, by the recipe's solver."""
    solvers = [option.solver_named(recipe.solver).at_effort(option.effort) for option in options]
    drawn = base_seed(torch.Generator().manual_seed(seed))
    poses = poses_of_pairs(source.cloud, target.cloud, matches, solvers, seed=drawn)
    return ProposedPoses(recipe.origin, matches, poses)


@stage("decision")
def decide(
    source: DescribedClouds,
    target: DescribedClouds,
    proposed: Sequence[ProposedPoses],
    options: Sequence[RegistrationOptions],
) -> RegistrationResult:
    """Take the solver's best pose of every pair (plain), or choose among all on the clouds and judge it."""
    effort = options[0].effort
    if effort == "plain":
        solvers = [option.solver for option in options]
        return result_of_poses(source.cloud, target.cloud, proposed[0].matches, proposed[0].poses, solvers)
    lengths = [
        PairLengths(option.inlier_threshold, max(spacings))
        for option, *spacings in zip(options, source.spacing, target.spacing, strict=True)
    ]
    return verify(source.cloud, target.cloud, proposed, lengths, WORK[effort])


def fused(side: DescribedClouds, recipe: Recipe, options: RegistrationOptions) -> Features:
    """Fuse the recipe's blocks, their histograms moved towards square roots by the options' ``root``."""
    blocks = []
    for number in recipe.blocks:
        block, record = side.features[number], side.descriptions[0].descriptors[number]
        if options.root > 0 and record.is_histogram:
            block = replace(block, values=rooted(block.values, options.root))
        blocks.append(block)
    return fuse(*blocks, weights=recipe.weights)
