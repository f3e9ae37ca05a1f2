"""Which pairs take their steps together: as many as the memory allows, large ones alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from torchreg.types import Clouds
from torchreg.verification.care import Care
from torchreg.verification.collect import Proposed

_ELEMENTS = 1 << 20
"""Work of a group at most: 30 to 60 pairs of 1,000 points. More gain nothing, and results do not depend on it."""


class Groups(NamedTuple):
    """The pairs that have poses.

    Attributes:
        small: numbers of pairs that go together.
        large: pairs that go alone.
    """

    small: list[list[int]]
    large: list[int]


def work_of_pairs(source: Clouds, target: Clouds, proposed: Sequence[Proposed], care: Care) -> list[int]:
    """Of every pair, its points and the points that its poses move; 0 without poses."""
    work = []
    for b, lengths in enumerate(zip(source.lengths, target.lengths, strict=True)):
        poses = sum(min(care.poses, len(part.poses[b].support)) for part in proposed)
        looked_at = sum(min(length, care.sample) for length in lengths)
        work.append(sum(lengths) + poses * looked_at if poses > 0 else 0)
    return work


def groups_of(work: Sequence[int], workers: int) -> Groups:
    """Cut pairs with this much work into groups, as many as there are workers where there is enough for them."""
    small = [b for b, amount in enumerate(work) if 0 < amount <= _ELEMENTS]
    most = min(_ELEMENTS, -(-sum(work[b] for b in small) // max(1, workers)))
    groups: list[list[int]] = []
    room = 0
    for b in small:
        if work[b] > room or not groups:
            groups.append([])
            room = max(most, work[b])
        groups[-1].append(b)
        room -= work[b]
    return Groups(groups, [b for b, amount in enumerate(work) if amount > _ELEMENTS])
