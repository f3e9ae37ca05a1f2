"""What is to be done: the options of every pair, the descriptions they need, and which pairs go together."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from torchreg.batch.clouds import CloudSource, Look, sources_of
from torchreg.batch.described_file import described_name
from torchreg.batch.jobs import DescribeItem, PairItem, Slice
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Told
from torchreg.batch.scales import Scale, options_of
from torchreg.registration.describe import without_lengths
from torchreg.registration.describing import description_options
from torchreg.registration.pair_options import changed
from torchreg.registration.presets import PAPER
from torchreg.registration.recipes import blocks_of, recipes_of
from torchreg.types import RegistrationOptions

CloudKey = tuple[CloudSource, float | None]
"""A cloud, and the voxel edge that was given for it."""

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


def clouds_of(pair: Pair) -> tuple[CloudKey, CloudKey]:
    """The clouds of a pair, with the voxel edge that their scale is measured after."""
    given = pair.settings.overrides.voxel if needs_scale(pair) else None
    one, other = sources_of(pair)
    return (one, given), (other, given)


def needs_scale(pair: Pair) -> bool:
    """Whether lengths follow from the clouds."""
    return pair.settings.preset == "default"


def options_for(pair: Pair, looks: Sequence[Look], scales: Sequence[Scale]) -> RegistrationOptions:
    """The complete options of a pair from what is known of its clouds, source and target."""
    colored = all(look.colored for look in looks)
    options = options_of(*scales, colored=colored) if needs_scale(pair) else PAPER
    options = pair.settings.overrides.over(options)
    return changed(options, pair.settings.effort, pair.settings.solver)


def pair_item(
    pair: Pair,
    options: RegistrationOptions,
    looks: Mapping[CloudKey, Look],
    folder: Path,
    bounds: Bounds,
    max_bytes: int,
) -> PairItem:
    """A pair with what its descriptions depend on, which are kept in a folder."""
    clouds = clouds_of(pair)
    colored = all(looks[cloud].colored for cloud in clouds)
    needed = description_options(options, blocks_of(recipes_of(options, colored)))
    sides = [
        DescribeItem(
            source, looks[source, asked].digest, needed, _file(folder, looks[source, asked], needed), max_bytes
        )
        for source, asked in clouds
    ]
    told = Told((sides[0].digest, sides[1].digest), bounds.degrees, bounds.meters)
    return PairItem(pair, options, sides[0], sides[1], told)


def missing_descriptions(items: Sequence[PairItem]) -> list[DescribeItem]:
    """The descriptions that are not on disk yet, each once."""
    wanted = {side.file: side for item in items for side in (item.source, item.target)}
    return [side for file, side in wanted.items() if not os.path.exists(file)]


def slices_of(items: Sequence[PairItem], looks: Mapping[CloudKey, Look], workers: int, max_bytes: int) -> list[Slice]:
    """Pairs that may go together, in order, as many as the memory of one worker allows."""
    alike: dict[object, list[PairItem]] = {}
    for item in items:
        colored = tuple(looks[cloud].colored for cloud in clouds_of(item.pair))
        key = (without_lengths(item.options), colored, item.pair.settings.seed)
        alike.setdefault(key, []).append(item)
    most = max(1, min(SLICE_PAIRS, -(-len(items) // (_ROUNDS * workers))))
    room = min(SLICE_BYTES, max_bytes // _HELD)
    return [part for group in alike.values() for part in _cut(group, most, room)]


def _cut(items: Sequence[PairItem], most: int, room: int) -> list[Slice]:
    found: list[Slice] = []
    part: list[PairItem] = []
    held = 0
    for item in items:
        size = sum(_size(side.file) for side in (item.source, item.target))
        if part and (len(part) == most or held + size > room):
            found.append(tuple(part))
            part, held = [], 0
        part.append(item)
        held += size
    return [*found, tuple(part)] if part else found


def _size(file: str) -> int:
    return os.stat(file).st_size if os.path.exists(file) else SLICE_BYTES


def _file(folder: Path, look: Look, options: RegistrationOptions) -> str:
    return str(folder / described_name(look.digest, options))
