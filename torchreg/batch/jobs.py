"""The kinds of work of a batch: measure a cloud, derive the options of a pair, describe a cloud, register a slice.

Each is loading, which reads files and needs a processor alone, and computing, which may run on another device.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from torchreg.batch.clouds import CloudMeasures, CloudSource, measure, read_source
from torchreg.batch.described_file import read_described, write_described
from torchreg.batch.engine import CannotKeepError, Job
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Bounds, Row, row_of
from torchreg.errors import expect_in_words
from torchreg.registration import DescribedClouds, derive_options, register_described
from torchreg.registration.describe import describe_by
from torchreg.registration.described import Description
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.same_clouds import digest_of
from torchreg.types import Clouds


class MeasureItem(NamedTuple):
    """A cloud to be measured; arguments as ``measure``'s."""

    source: CloudSource
    voxel: float | None
    scaled: bool


class DeriveItem(NamedTuple):
    """A pair whose options are to be derived from its two clouds alone, at an effort."""

    source: CloudSource
    target: CloudSource
    effort: str


class DescribeItem(NamedTuple):
    """A cloud to be described."""

    source: CloudSource  # where it is read
    digest: str  # what it is expected to hold
    description: Description  # what it is described with
    file: str  # where its description is kept


class PairItem(NamedTuple):
    """One pair of a slice: its options, its clouds, which of them have colors, and when its pose counts as found."""

    pair: Pair
    options: RegistrationOptions
    source: DescribeItem
    target: DescribeItem
    colored: tuple[bool, bool]
    bounds: Bounds


Slice = tuple[PairItem, ...]
"""Pairs that go together: alike in options but for lengths, and in which clouds have colors."""


def _load_measured(item: MeasureItem) -> Clouds:
    return read_source(item.source)


def _measure(item: MeasureItem, cloud: Clouds, device: str) -> CloudMeasures:
    return measure(cloud, item.voxel, scaled=item.scaled)


def _load_pair(item: DeriveItem) -> tuple[Clouds, Clouds]:
    return read_source(item.source), read_source(item.target)


def _derive(item: DeriveItem, clouds: tuple[Clouds, Clouds], device: str) -> RegistrationOptions:
    return derive_options(*clouds, effort=item.effort)[0]


def _load_cloud(item: DescribeItem) -> Clouds:
    cloud = read_source(item.source)
    same = digest_of(cloud) == item.digest
    expect_in_words(same, item.source.path, "the cloud that it held when the run measured it", "another, changed since")
    return replace(cloud, normals=None)


def _describe(item: DescribeItem, cloud: Clouds, device: str) -> int:
    return len(_described(item, cloud, device).cloud.points)


def _load_slice(item: Slice) -> dict[str, DescribedClouds | Clouds]:
    """The described clouds of a slice by their files; where a file is missing or damaged, the cloud itself."""
    clouds = {side.file: side for pair in item for side in (pair.source, pair.target)}
    return {file: read_described(Path(file), side.description) or _load_cloud(side) for file, side in clouds.items()}


def _described(item: DescribeItem, loaded: DescribedClouds | Clouds, device: str) -> DescribedClouds:
    """A description as it was kept, or made again and kept now."""
    if isinstance(loaded, DescribedClouds):
        return loaded.to(device)
    described = describe_by(loaded.to(device), [item.description])
    try:
        write_described(Path(item.file), described.to("cpu"))
    except (OSError, ValueError) as error:  # a full disk, a folder that was removed or is closed
        raise CannotKeepError(f"{item.file}: {error}") from None
    return described


def _register(item: Slice, loaded: dict[str, DescribedClouds | Clouds], device: str) -> list[Row]:
    clouds = {side.file: side for pair in item for side in (pair.source, pair.target)}
    described = {file: _described(side, loaded[file], device) for file, side in clouds.items()}
    sides = [
        DescribedClouds.pack([described[getattr(pair, side).file] for pair in item]) for side in ("source", "target")
    ]
    settings = item[0].pair.settings
    result = register_described(sides[0], sides[1], [pair.options for pair in item], seed=settings.seed)
    return [
        row_of(
            pair.pair,
            result,
            b,
            source=sides[0].cloud.select(b),
            digests=(pair.source.digest, pair.target.digest),
            bounds=pair.bounds,
        )
        for b, pair in enumerate(item)
    ]


MEASURE = Job(_load_measured, _measure)
DERIVE = Job(_load_pair, _derive)
DESCRIBE = Job(_load_cloud, _describe)
REGISTER = Job(_load_slice, _register)
