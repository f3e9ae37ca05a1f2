"""Which sets of features and which solvers compete for a pair.

Points that look alike in one set of features may differ in another, so the poses of several sets are candidates
together. The sets share their descriptors: each is computed once.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from torchreg.descriptors.fuse import fuse, rooted
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.types import Features


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


def fused(side: DescribedClouds, recipe: Recipe, options: RegistrationOptions) -> Features:
    """Fuse the recipe's blocks, their histograms moved towards square roots by the options' ``root``."""
    blocks = []
    for number in recipe.blocks:
        block, record = side.features[number], side.descriptions[0].descriptors[number]
        if options.root > 0 and record.is_histogram:
            block = replace(block, values=rooted(block.values, options.root))
        blocks.append(block)
    return fuse(*blocks, weights=recipe.weights)
