"""What is to be done: the descriptions that pairs need, and which pairs go together."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from torchreg.batch.clouds import Look, sources_of
from torchreg.batch.described_file import described_name
from torchreg.batch.jobs import DescribeItem, PairItem, Slice
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Told
from torchreg.registration.describe import without_lengths
from torchreg.registration.describing import description_options
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.recipes import blocks_of, recipes_of

SLICE_PAIRS = 16
"""Pairs of a slice at most: what is lost when a run is cut off."""

SLICE_BYTES = 12 << 20
"""Of descriptions of a slice: some 40,000 points. Beyond it, going together saves nothing."""

_HELD = 6  # what a slice holds while it is worked on, as a multiple of its descriptions
_ROUNDS = 4  # slices for every worker at least, so that all end at about the same time


class Bounds(NamedTuple):
    """When a pair with a truth counts as found: below these errors; ``meters`` ``None`` for four inlier thresholds."""

    degrees: float
    meters: float | None


def pair_item(
    pair: Pair, options: RegistrationOptions, looks: tuple[Look, Look], folder: Path, device: str, bounds: Bounds
) -> PairItem:
    """A pair with what its descriptions depend on, which are kept in a folder."""
    colored = (looks[0].colored, looks[1].colored)
    needed = description_options(options, blocks_of(recipes_of(options, all(colored))))
    sides = [
        DescribeItem(source, look.digest, needed, str(folder / described_name(look.digest, needed, device)))
        for source, look in zip(sources_of(pair), looks, strict=True)
    ]
    told = Told((looks[0].digest, looks[1].digest), bounds.degrees, bounds.meters)
    return PairItem(pair, options, sides[0], sides[1], colored, told)


def missing_descriptions(items: Sequence[PairItem]) -> list[DescribeItem]:
    """The descriptions that are not on disk yet, each once; those of the largest files first."""
    wanted = {side.file: side for item in items for side in (item.source, item.target)}
    missing = [side for file, side in wanted.items() if not os.path.exists(file)]
    return sorted(missing, key=lambda side: -_bytes(side.source.path))


def slices_of(items: Sequence[PairItem], workers: int, max_bytes: int) -> list[Slice]:
    """Pairs that may go together, as many as the memory of one worker allows; the largest first.

    So the workers end at about the same time.
    """
    alike: dict[object, list[PairItem]] = {}
    for item in items:
        key = (without_lengths(item.options), item.colored, item.pair.settings.seed)
        alike.setdefault(key, []).append(item)
    most = max(1, min(SLICE_PAIRS, -(-len(items) // (_ROUNDS * workers))))
    room = min(SLICE_BYTES, max_bytes // _HELD)
    found = [part for group in alike.values() for part in _cut(group, most, room)]
    return sorted(found, key=lambda part: -sum(_held(item) for item in part))


def _bytes(path: str) -> int:
    return os.stat(path).st_size if os.path.exists(path) else 0


def _cut(items: Sequence[PairItem], most: int, room: int) -> list[Slice]:
    found: list[Slice] = []
    part: list[PairItem] = []
    held = 0
    for item in items:
        size = _held(item)
        if part and (len(part) == most or held + size > room):
            found.append(tuple(part))
            part, held = [], 0
        part.append(item)
        held += size
    return [*found, tuple(part)] if part else found


def _held(item: PairItem) -> int:
    return _bytes(item.source.file) + _bytes(item.target.file)
