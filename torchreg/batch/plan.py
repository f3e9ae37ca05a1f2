"""The work of a run: the descriptions that pairs need, and the slices of pairs that are registered together."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from torchreg.batch.clouds import CloudMeasures, sources_of
from torchreg.batch.described_file import described_name
from torchreg.batch.jobs import DescribeItem, PairItem, Slice
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Bounds
from torchreg.geometry.numerics.partition import partition
from torchreg.registration.describe import description_of
from torchreg.registration.options import RegistrationOptions
from torchreg.types.lengths import besides_lengths

SLICE_PAIRS = 16
"""Pairs of a slice at most: what is lost when a run is cut off."""

SLICE_BYTES = 12 << 20
"""Bytes of the descriptions of a slice, some 40,000 points; in larger slices pairs save nothing by going together."""

_MEMORY_FACTOR = 6  # memory that a slice needs while it is worked on, as a multiple of its descriptions
_ROUNDS = 4  # slices for every worker at least, so that all end at about the same time


def pair_item(
    pair: Pair,
    options: RegistrationOptions,
    measures: tuple[CloudMeasures, CloudMeasures],
    folder: Path,
    device: str,
    bounds: Bounds,
) -> PairItem:
    """A pair with what its descriptions depend on, which are kept in a folder."""
    colored = (measures[0].colored, measures[1].colored)
    description = description_of(options, colored=all(colored))
    sides = [
        DescribeItem(source, one.digest, description, str(folder / described_name(one.digest, description, device)))
        for source, one in zip(sources_of(pair), measures, strict=True)
    ]
    return PairItem(pair, options, sides[0], sides[1], colored, bounds)


def missing_descriptions(items: Sequence[PairItem]) -> list[DescribeItem]:
    """The descriptions that are not on disk yet, each once; those of the largest files first."""
    wanted = {side.file: side for item in items for side in (item.source, item.target)}
    missing = [side for file, side in wanted.items() if not os.path.exists(file)]
    return sorted(missing, key=lambda side: -_bytes(side.source.path))


def slices_of(items: Sequence[PairItem], workers: int, max_bytes: int) -> list[Slice]:
    """Pairs that may go together, as many as fit in the memory of one worker; large slices first, so that all workers
    end at about the same time."""
    alike: dict[object, list[PairItem]] = {}
    for item in items:
        key = (besides_lengths(item.options), item.colored, item.pair.settings.seed)
        alike.setdefault(key, []).append(item)
    most = max(1, min(SLICE_PAIRS, -(-len(items) // (_ROUNDS * workers))))
    room = min(SLICE_BYTES, max_bytes // _MEMORY_FACTOR)
    slices = []
    for group in alike.values():
        for run in partition([_described_bytes(item) for item in group], room):
            part = group[run]
            slices += [tuple(part[begin : begin + most]) for begin in range(0, len(part), most)]
    return sorted(slices, key=lambda part: -sum(_described_bytes(item) for item in part))


def _bytes(path: str) -> int:
    return os.stat(path).st_size if os.path.exists(path) else 0


def _described_bytes(item: PairItem) -> int:
    return _bytes(item.source.file) + _bytes(item.target.file)
