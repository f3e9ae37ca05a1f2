"""The plan of one call: options of every pair, clouds shared by pairs, slices that fit the memory, results joined.

A cloud may stand in many pairs. Equal clouds get one number (``same_clouds``). A *job* is a number with what its cloud
is described by, and a pair is two jobs. Every job is done once, when the first slice of pairs needs it, and its result
is dropped after the last.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import psutil
import torch

from torchreg.errors import at_least, expect, expect_device
from torchreg.geometry.numerics.partition import partition
from torchreg.refinement.pairing import numbered
from torchreg.refinement.surfels import Surfels
from torchreg.registration.describe import description_of, downsample, expect_alike, hinted, surfels
from torchreg.registration.described import DescribedClouds, Description
from torchreg.registration.inspect import facts_of, refusal, set_aside, warn_of_many_points
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.same_clouds import same_clouds
from torchreg.registration.spacing import derive_numbered
from torchreg.registration.stopwatch import stage
from torchreg.solvers import Solver
from torchreg.types import Clouds, Failure, RegistrationResult

SHARE = 0.25
"""Share of the free memory that a call may use where ``max_bytes`` is not given."""

_POINT_BYTES = 2000  # of a described point: itself, its descriptors, their copies in the slice and in its features
_PAIR_BYTES = 1 << 20  # of a pair whatever its size: hypotheses and candidates
_NOTHING = -1  # the number of a cloud without points, which takes the place of those of refused pairs


Describe = Callable[[Clouds, Sequence[Description], int], DescribedClouds]
"""Describes thinned clouds, each by its description, with so many bytes for neighborhoods: ``describe_thin``."""


class _Job(NamedTuple):
    """A cloud to be described."""

    cloud: int  # its number
    description: Description  # what it is described by
    pair: int = -1  # the pair that it is described for, where a descriptor looks at both clouds; else -1
    side: int = 0  # 0 for the source of that pair, 1 for the target; else 0


class Plan:
    """The options and slices of a call of ``register``, and the described clouds of each slice.

    What a cloud is described by follows from the options by ``described_by``; ``point_bytes`` is the memory of a point
    for what is kept beside its description.

    Attributes:
        options: of every pair.
        colored: whether both sides have colors.
        slices: pairs that fit the memory together.
    """

    def __init__(
        self,
        source: Clouds,
        target: Clouds,
        options: RegistrationOptions | Sequence[RegistrationOptions] | None,
        *,
        effort: str | None,
        solver: Solver | str | None,
        refine: str | None,
        max_bytes: int | None,
        described_by: Callable[..., Description] = description_of,
        point_bytes: int = 0,
    ) -> None:
        expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
        expect(len(source) > 0, "source", "at least one cloud", len(source))
        expect_device(target.points, "target", source.device)
        expect(target.points.dtype == source.points.dtype, "target", f"points in {source.points.dtype}", target.points)
        self._budget, self._described_by = budget(max_bytes, source.device), described_by
        source, target = source.detach(), target.detach()
        self.colored = source.colors is not None and target.colors is not None
        self._numbers = same_clouds([source, target])
        single = [*source.unpack(), *target.unpack()]
        distinct = {number: single[number] for side in self._numbers for number in side}
        self._facts = {number: facts_of(cloud)[0] for number, cloud in distinct.items()}
        self.options = self._options(source, target, options, effort, solver, refine)
        # colors of one side alone are of no use; normals are there for all clouds or none, so that they can be packed
        hints = any(cloud.normals is not None for cloud in distinct.values())
        clouds = {
            number: hinted(
                replace(
                    cloud,
                    normals=torch.zeros_like(cloud.points) if hints and cloud.normals is None else cloud.normals,
                    colors=cloud.colors if self.colored else None,
                )
            )
            for number, cloud in distinct.items()
        }
        clouds[_NOTHING] = set_aside(clouds[self._numbers[0][0]], [True])
        jobs = [self._job(b, side) for side in range(2) for b in range(len(source))]
        self._jobs, numbers = numbered(jobs)
        self._pairs = list(zip(numbers[: len(source)], numbers[len(source) :], strict=True))
        self._clouds, self._surfels = clouds, dict[int, Surfels]()
        self._thin = [downsample(clouds[job.cloud], [job.description.voxel_size]) for job in self._jobs]
        self._last = {job: b for b, pair in enumerate(self._pairs) for job in pair}
        self._described: dict[int, DescribedClouds] = {}
        for options, pair in zip(self.options, self._pairs, strict=True):
            warn_of_many_points(max(len(self._thin[job].points) for job in pair), options)
        sizes = [sum(len(self._thin[job].points) for job in pair) for pair in self._pairs]
        self.slices = partition(
            [pair_bytes(size, self.options[0]) + point_bytes * size for size in sizes], self._budget
        )

    def sides(self, rows: slice, describe: Describe) -> tuple[DescribedClouds, DescribedClouds]:
        """Both sides of the pairs of a slice, slice after slice: what no earlier slice had is described now.

        What no later pair needs is dropped.
        """
        pairs = self._pairs[rows]
        new = [job for job in dict.fromkeys(job for pair in pairs for job in pair) if job not in self._described]
        if new:
            thin = Clouds.pack([self._thin[job] for job in new])
            described = describe(thin, [self._jobs[job].description for job in new], self._budget)
            self._described.update(zip(new, map(self._with_surfels, new, described.unpack()), strict=True))
        sides = [
            replace(
                DescribedClouds.pack([self._described[pair[side]] for pair in pairs]),
                facts=tuple(self._facts[number] for number in self._numbers[side][rows]),
            )
            for side in range(2)
        ]
        # what later pairs need is copied out of its batch, so that the memory of the batch is freed
        later = {job: cloud for job, cloud in self._described.items() if self._last[job] >= rows.stop}
        self._described = {job: cloud.clone() if job in new else cloud for job, cloud in later.items()}
        return sides[0], sides[1]

    def _with_surfels(self, job: int, described: DescribedClouds) -> DescribedClouds:
        """A described cloud with its surfels; those of clouds as given are made once, whatever else differs."""
        number, description = self._jobs[job].cloud, self._jobs[job].description
        made = self._surfels.get(number)
        if made is None:
            made = surfels(self._clouds[number], described.cloud, [description])
            if made is not None and description.refine == "full":
                self._surfels[number] = made
        return replace(described, surfels=made)

    @stage("options")
    def _options(
        self,
        source: Clouds,
        target: Clouds,
        options: RegistrationOptions | Sequence[RegistrationOptions] | None,
        effort: str | None,
        solver: Solver | str | None,
        refine: str | None,
    ) -> tuple[RegistrationOptions, ...]:
        """One per pair; derived from the spacing of the points for ``None``."""
        if options is None:
            refused = [self._refusal(b, None) for b in range(len(source))]
            usable = (set_aside(source, refused), set_aside(target, refused))
            numbers = [
                [_NOTHING if failure else number for number, failure in zip(side, refused, strict=True)]
                for side in self._numbers
            ]
            options = derive_numbered(*usable, numbers, "balanced" if effort is None else effort)
        return options_of_pairs(options, len(source), effort, solver, refine)

    def _refusal(self, b: int, options: RegistrationOptions | None) -> Failure | None:
        return refusal(self._facts[self._numbers[0][b]], self._facts[self._numbers[1][b]], options)

    def _job(self, b: int, side: int) -> _Job:
        number = _NOTHING if self._refusal(b, self.options[b]) else self._numbers[side][b]
        description = self._described_by(self.options[b], colored=self.colored)
        return _Job(number, description, b, side) if description.is_pairwise else _Job(number, description)


def options_of_pairs(
    options: RegistrationOptions | Sequence[RegistrationOptions],
    pairs: int,
    effort: str | None = None,
    solver: Solver | str | None = None,
    refine: str | None = None,
) -> tuple[RegistrationOptions, ...]:
    """One per pair, with another effort, solver or refinement where one is named.

    Raises:
        ValueError: another type or number, or options that differ in more than lengths.
    """
    if isinstance(options, RegistrationOptions):
        options = (options,) * pairs
    listed = isinstance(options, Sequence) and all(isinstance(option, RegistrationOptions) for option in options)
    expect(listed, "options", "RegistrationOptions, one per pair or one for all", options)
    expect(len(options) == pairs, "options", f"one for all or one per pair ({pairs})", len(options))
    if solver is not None:
        change: dict[str, Any] = {"solver": solver}  # by name or as a record
        options = [replace(option, **change) for option in options]
    if effort is not None:
        options = [replace(option, effort=effort) for option in options]
    if refine is not None:
        options = [replace(option, refine=refine) for option in options]
    expect_alike(options)
    return tuple(options)


def budget(max_bytes: int | None, device: torch.device) -> int:
    """The bytes that a call may work with: ``max_bytes``, or a quarter of what is free on the device now."""
    if max_bytes is not None:
        return at_least(max_bytes, "max_bytes", 1)
    free = torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else psutil.virtual_memory().available
    return int(SHARE * free)


def pair_bytes(points: int, options: RegistrationOptions) -> int:
    """Estimate the memory that a pair of this many points, both clouds together, takes to be matched and solved."""
    return _PAIR_BYTES + points * _POINT_BYTES * (2 if options.effort == "thorough" else 1)


def joined(results: Sequence[RegistrationResult], *, seconds: dict[str, float]) -> RegistrationResult:
    """Join the results of the slices of one call, at least one; rows of matches count on through all clouds."""
    times = tuple(seconds.items())
    timed = [replace(result, seconds=times) for result in results]
    return timed[0] if len(timed) == 1 else RegistrationResult.pack(timed)
