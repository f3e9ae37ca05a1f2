"""The plan of a call whose features or matches come from elsewhere: they stay with the points that they were given for.

Clouds are described as by ``Plan``, by what judges poses alone, but their points are taken as they are; where options
ask for voxels, some of them are chosen (``kept_points``). Inside, points go in Z order; the result has the order that
they were given in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.registration.describe import describe_thin, downsample, judging_description, surfels
from torchreg.registration.described import DescribedClouds
from torchreg.registration.inspect import facts_of
from torchreg.registration.kept_points import KeptPoints, kept_points
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import Plan, options_of_pairs
from torchreg.registration.spacing import options_for, spacing, usable
from torchreg.registration.stopwatch import stage
from torchreg.solvers import Solver
from torchreg.types import Clouds, Features, RegistrationResult
from torchreg.types.packing import kept_rows, spans


class Wanted(NamedTuple):
    """Which points have something to be matched by."""

    source: Tensor  # (P,) bool
    target: Tensor  # (Q,) bool
    every: bool  # whether all of them stay where voxels thin the clouds, and not one for each voxel


class OutsidePlan:
    """The options and slices of a call, and the described clouds of each slice.

    Attributes:
        options: of every pair, as the result has them.
        colored: whether both sides have colors.
        slices: pairs that fit the memory together.
        kept: the points of both sides that are used.
    """

    def __init__(
        self,
        source: Clouds,
        target: Clouds,
        options: RegistrationOptions | Sequence[RegistrationOptions] | None,
        wanted: Wanted,
        *,
        effort: str | None,
        solver: Solver | str | None,
        refine: str | None,
        max_bytes: int | None,
        point_bytes: int = 0,
    ) -> None:
        source, target = source.detach(), target.detach()
        if options is None:
            options = _as_they_are(source, target, "balanced" if effort is None else effort)
        self.options = options_of_pairs(options, len(source), effort, solver, refine)
        if wanted.every:  # matches say themselves which points they are of
            self.options = tuple(replace(option, keypoints=None) for option in self.options)
        voxels = [option.voxel_size for option in self.options]
        self.kept: tuple[KeptPoints, KeptPoints] = (
            kept_points(source, voxels, wanted.source, every=wanted.every),
            kept_points(target, voxels, wanted.target, every=wanted.every),
        )
        self._given = source.offsets, target.offsets
        self._thinned = (source, target) if any(voxel is not None for voxel in voxels) else None
        self._plan = Plan(
            self.kept[0].cloud,
            self.kept[1].cloud,
            [replace(option, voxel_size=None) for option in self.options],
            effort=None,
            solver=None,
            refine=None,
            max_bytes=max_bytes,
            described_by=judging_description,
            point_bytes=point_bytes,
        )
        self.colored, self.slices = self._plan.colored, self._plan.slices

    def sides(self, pairs: slice) -> tuple[DescribedClouds, DescribedClouds]:
        """Both sides of the pairs of a slice, slice after slice."""
        described = self._plan.sides(pairs, describe_thin)
        if self._thinned is None:
            return described
        one, other = (self._as_given(*both, pairs) for both in zip(described, self._thinned, strict=True))
        return one, other

    def features(self, pairs: slice, side: int, described: DescribedClouds, features: Features) -> DescribedClouds:
        """A described side of a slice with the features of its points, given for all points of that side."""
        offsets = self.kept[side].cloud.offsets
        begin, end = int(offsets[pairs.start]), int(offsets[pairs.stop])
        rows = self.kept[side].rows[begin:end]
        kept, own = kept_rows(offsets[pairs.start : pairs.stop + 1] - begin, _empty(described.cloud))
        rows = rows[kept.to(rows.device)]
        return replace(described, outside=Features(features.values[rows], own, features.blocks, features.valid[rows]))

    def places(self, side: int, rows: Sequence[Tensor]) -> list[Tensor]:
        """Rows of every given cloud of a side, as rows of what is kept of that cloud; all of them must be kept."""
        cloud, kept = self.kept[side]
        moved = []
        for (begin, end), (first, _), of_cloud in zip(
            spans(cloud.offsets), spans(self._given[side]), rows, strict=True
        ):
            own = kept[begin:end] - first
            most = int(own.amax()) + 1 if len(own) > 0 else 0
            place = own.new_zeros(most).index_put((own,), torch.arange(len(own), device=own.device))
            moved.append(place[of_cloud])
        return moved

    def in_given_order(self, result: RegistrationResult) -> RegistrationResult:
        """The result with the points of every cloud in the order that they were given in."""
        (source, of_source), (target, of_target) = (
            self._reordered(side, cloud) for side, cloud in enumerate((result.source, result.target))
        )
        matches = replace(
            result.correspondences,
            source=of_source[result.correspondences.source],
            target=of_target[result.correspondences.target],
        )
        return replace(result, source=source, target=target, correspondences=matches)

    def _as_given(self, described: DescribedClouds, given: Clouds, pairs: slice) -> DescribedClouds:
        """Facts and surfels of the clouds before they were thinned; refused ones keep what they have."""
        chosen = given.select(range(len(given))[pairs])
        facts = facts_of(chosen)
        if described.surfels is None or described.descriptions[0].refine != "full":
            return replace(described, facts=facts)
        usable = [not empty for empty in _empty(described.cloud)]
        kept, offsets = kept_rows(chosen.offsets, [not each for each in usable])
        whole = downsample(chosen.rows(kept.to(chosen.device), offsets), [None] * len(chosen))
        return replace(described, facts=facts, surfels=surfels(whole, described.cloud, described.descriptions))

    def _reordered(self, side: int, cloud: Clouds) -> tuple[Clouds, Tensor]:
        """One side of the result in the given order, and for every row of the result its place there."""
        given, rows = self.kept[side]
        index, moved = [], []
        for (begin, end), (first, last) in zip(spans(cloud.offsets), spans(given.offsets), strict=True):
            order = rows[first:last].argsort() if end > begin else rows[:0]
            index.append(begin + order)
            moved.append(begin + torch.empty_like(order).index_put((order,), torch.arange(len(order)).to(order)))
        return cloud.rows(torch.cat(index), cloud.offsets), torch.cat(moved)


@stage("options")
def _as_they_are(source: Clouds, target: Clouds, effort: str) -> list[RegistrationOptions]:
    """Options derived from the spacing of the points of every pair, which no voxels thin."""
    colored = source.colors is not None and target.colors is not None
    options = []
    for pair in zip(source.unpack(), target.unpack(), strict=True):
        apart = max(float(spacing(cloud)) for cloud in pair) if all(map(usable, pair)) else 0.0
        derived = options_for(apart if apart > 0 else 1.0, colored=colored)
        options.append(replace(derived, effort=effort, refine="none" if effort == "plain" else derived.refine))
    return options


def _empty(cloud: Clouds) -> list[bool]:
    return [length == 0 for length in cloud.lengths]
