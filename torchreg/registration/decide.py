"""The decision on pairs: all poses weighed on the clouds and judged, and pairs in doubt looked at once more.

The first look proposes poses in one or a few ways. Where its best pose does not convince, a second ``Look`` proposes
more, and all of them are judged together; so an easy pair costs little, and a hard one is given what it needs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

from torch import Tensor

from torchreg.descriptors.fuse import unit_rows
from torchreg.geometry.numerics.threads import shared_out
from torchreg.native import kernel_threads
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.stopwatch import stage
from torchreg.types import Failure, Proposal
from torchreg.types.packing import spans
from torchreg.verification import (
    WORK_AGAIN,
    OverlapFeatures,
    PairLengths,
    ProposedPoses,
    proposals_of,
)
from torchreg.verification.impostors import IMPOSTORS
from torchreg.verification.judge import judge_poses
from torchreg.verification.verdicts import JudgedPair

Look = Callable[[int, DescribedClouds, DescribedClouds, RegistrationOptions, int, Collection[str]], list[ProposedPoses]]
"""Proposes more poses of one pair: its number, its clouds, its options, a seed, origins of proposals there are."""


class SecondLook(NamedTuple):
    """What a second look at one pair showed."""

    judged: JudgedPair  # over the poses of both looks
    proposals: tuple[Proposal, ...]  # besides those of the first look


def compared(
    source: DescribedClouds, target: DescribedClouds, options: Sequence[RegistrationOptions]
) -> tuple[list[PairLengths], list[OverlapFeatures]]:
    """What ``judge_poses`` compares the two clouds of every pair by: lengths, and features of their points."""
    lengths = [
        PairLengths(option.inlier_threshold, max(spacings))
        for option, *spacings in zip(options, source.spacing, target.spacing, strict=True)
    ]
    known = (source.cloud.viewpoint_known & target.cloud.viewpoint_known).tolist()
    features = zip(_described_rows(source, known), _described_rows(target, known), strict=True)
    return lengths, [OverlapFeatures(*sides) for sides in features]


@stage("second look")
def look_again(
    source: DescribedClouds,
    target: DescribedClouds,
    proposed: Sequence[ProposedPoses],
    judged: Sequence[JudgedPair],
    options: Sequence[RegistrationOptions],
    seed: int,
    look: Look,
) -> dict[int, SecondLook]:
    """Look again at pairs, each by itself: at ``"balanced"`` those that are refused, at ``"thorough"`` all."""
    work = WORK_AGAIN.get(options[0].effort)
    if work is None:
        return {}
    pairs = enumerate(zip(judged, source.cloud.lengths, target.cloud.lengths, strict=True))
    again = [
        b
        for b, (pair, *lengths) in pairs
        if min(lengths) > 0 and _in_doubt(pair.verdict.failure, always=options[b].effort == "thorough")
    ]
    if not again:
        return {}
    sources, targets = source.unpack(), target.unpack()

    def judged_again(b: int) -> SecondLook:
        before = {part.origin for part in proposed}
        seen = look(b, sources[b], targets[b], options[b], seed, before)
        both = [part.of_pair(b, source.cloud, target.cloud) for part in proposed] + seen
        one, other = sources[b], targets[b]
        pair = judge_poses(one.cloud, other.cloud, both, *compared(one, other, options[b : b + 1]), work)[0]
        return SecondLook(pair, proposals_of(seen, 0))

    workers = kernel_threads() if source.cloud.device.type == "cpu" else 1
    return dict(zip(again, shared_out(judged_again, again, workers), strict=True))


def _in_doubt(failure: Failure | None, *, always: bool) -> bool:
    """Whether a second look may help: not where no rigid pose can be right."""
    return always if failure is None else failure.kind not in IMPOSTORS


def _described_rows(side: DescribedClouds, known: Sequence[bool]) -> list[tuple[Tensor | None, Tensor | None]]:
    """Of every cloud, rows of unit length: the first descriptor of geometry, and the first of color.

    Where the scanners of both clouds are not ``known``, what depends on the sign of the normals is left out.
    """
    first: dict[bool, int] = {}
    for number, record in enumerate(side.descriptions[0].descriptors):
        if not record.is_pairwise:
            first.setdefault(record.needs_colors, number)

    def rows(b: int, begin: int, end: int, number: int | None) -> Tensor | None:
        if number is None:
            return None
        values = side.features[number].values[begin:end]
        return unit_rows(values if known[b] else side.descriptions[b].descriptors[number].unsigned(values))

    both = (first.get(False), first.get(True))
    return [
        (rows(b, begin, end, both[0]), rows(b, begin, end, both[1]))
        for b, (begin, end) in enumerate(spans(side.cloud.offsets))
    ]
