"""From two sides that are described to poses: which sets of features and which solvers compete, and what they propose.

What one set of features blurs another may tell apart, so the poses of several sets are candidates together
(``torchreg.verification`` chooses among them). The sets share their descriptors: each is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch

from torchreg.descriptors.fuse import fuse, rooted
from torchreg.matching.mutual import match_mutual
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions, solver_by_name
from torchreg.registration.stopwatch import stage
from torchreg.solvers.batch import poses_of_pairs
from torchreg.solvers.points import base_seed
from torchreg.types import Correspondences, Features
from torchreg.verification import ProposedPoses


class Recipe(NamedTuple):
    """One way from descriptors to poses."""

    blocks: tuple[int, ...]  # numbers of the descriptors that are fused
    names: tuple[str, ...]  # of these
    weights: tuple[float, ...]  # of these
    neighbors: int  # nearest rows that may match
    solver: str  # by name

    @property
    def origin(self) -> str:
        """The recipe in words, such as "fpfh + contrast, 2 nearest, compatibility"."""
        several = f", {self.neighbors} nearest" if self.neighbors > 1 else ""
        return " + ".join(self.names) + f"{several}, {self.solver}"


def recipes_of(options: RegistrationOptions, *, colored: bool) -> tuple[Recipe, ...]:
    """What to try, the options' own recipe first.

    Plain and fast try that one alone; balanced also the geometry by itself; thorough each color block beside the
    geometry too, and all of these both by compatibility with two nearest neighbors and by RANSAC.

    Args:
        options: of the pairs.
        colored: whether the pairs have colors; without, blocks that need them are left out.
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

    own = recipe(everything, options.match_neighbors, options.solver.name)
    if options.effort in ("plain", "fast"):
        return (own,)
    sets = [everything, geometry] if geometry else [everything]
    if options.effort == "balanced":
        return tuple(dict.fromkeys(recipe(numbers, own.neighbors, own.solver) for numbers in sets))
    sets += [(*geometry, number) for number in color]
    several = own.neighbors if options.ratio is not None else max(own.neighbors, 2)
    ways = ((several, "compatibility"), (own.neighbors, "ransac"))
    return tuple(dict.fromkeys((own, *(recipe(numbers, *way) for numbers in dict.fromkeys(sets) for way in ways))))


@stage("matching")
def match(
    source: DescribedClouds, target: DescribedClouds, recipe: Recipe, options: RegistrationOptions
) -> Correspondences:
    """Fuse the recipe's blocks and match them mutually."""
    one, other = (fused(side, recipe, options) for side in (source, target))
    return match_mutual(one, other, ratio=options.ratio, neighbors=recipe.neighbors)


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
    solvers = [solver_by_name(recipe.solver, option.solver).at_effort(option.effort) for option in options]
    drawn = base_seed(torch.Generator().manual_seed(seed))
    poses = poses_of_pairs(source.cloud, target.cloud, matches, solvers, seed=drawn)
    return ProposedPoses(recipe.origin, matches, poses)


def fused(side: DescribedClouds, recipe: Recipe, options: RegistrationOptions) -> Features:
    """The recipe's blocks as one vector, histograms moved towards square roots as the options say."""
    blocks = []
    for number in recipe.blocks:
        block, record = side.features[number], side.descriptors[0][number]
        if options.root > 0 and record.is_histogram:
            block = replace(block, values=rooted(block.values, options.root))
        blocks.append(block)
    return fuse(*blocks, weights=recipe.weights)
