"""Which sets of features and which solvers compete for a pair.

Points that look alike in one set of features may differ in another, so the poses of several sets are candidates
together. The sets share their descriptors: each is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from torchreg.descriptors.descriptor import Descriptor
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

    Plain, fast and balanced try that one alone; thorough also the geometry by itself and each color block beside the
    geometry, and all of these both by compatibility with two nearest neighbors and by RANSAC.
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
    if options.effort != "thorough":
        return (first,)
    sets = [everything, geometry] if geometry else [everything]
    sets += [tuple(sorted((*geometry, number))) for number in color]
    ways = _thorough_ways(options)
    return tuple(dict.fromkeys((first, *(recipe(numbers, *way) for numbers in dict.fromkeys(sets) for way in ways))))


def outside_recipes(names: tuple[str, ...], options: RegistrationOptions) -> tuple[Recipe, ...]:
    """The recipes to try with one set of features from elsewhere, of these names: as ``recipes_of`` with one set."""
    first = Recipe((), names, (), options.match_neighbors, options.solver.name)
    ways = _thorough_ways(options) if options.effort == "thorough" else ()
    return tuple(dict.fromkeys((first, *(Recipe((), names, (), *way) for way in ways))))


def _thorough_ways(options: RegistrationOptions) -> tuple[tuple[int, str], ...]:
    """Nearest rows that may match, and the solver, of every set of features."""
    several = options.match_neighbors if options.ratio is not None else max(options.match_neighbors, 2)
    return (several, "compatibility"), (options.match_neighbors, "ransac")


def fused(side: DescribedClouds, recipe: Recipe, options: RegistrationOptions) -> Features:
    """Fuse the recipe's blocks, their histograms moved towards square roots by the options' ``root``.

    Points that are not matched are not valid.
    """
    records = [side.descriptions[0].descriptors[number] for number in recipe.blocks]
    blocks = [side.features[number] for number in recipe.blocks]
    return side.matched(fused_blocks(blocks, records, recipe.weights, options.root))


def fused_blocks(
    blocks: Sequence[Features], records: Sequence[Descriptor], weights: Sequence[float], root: float
) -> Features:
    """Fuse the features of descriptors, histograms moved towards square roots by ``root`` in [0, 1]."""
    parts = [
        replace(block, values=rooted(block.values, root)) if root > 0 and record.is_histogram else block
        for block, record in zip(blocks, records, strict=True)
    ]
    return fuse(*parts, weights=tuple(weights))
