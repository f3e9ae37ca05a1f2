"""The kinds of work of a batch: look at a cloud, derive a pair's options, describe a cloud, register a slice.

Each is loading, which reads files and needs a processor alone, and computing, which may run on another device.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from torchreg.batch.clouds import CloudSource, Look, digest_of, look_at, read_source
from torchreg.batch.described_file import read_described, write_described
from torchreg.batch.outcome import Outcome, attempt
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Row, Told, row_of
from torchreg.errors import expect
from torchreg.registration import DescribedClouds, derive_options, describe_clouds, register_described
from torchreg.registration.options import RegistrationOptions
from torchreg.types import Clouds


class Job(NamedTuple):
    """One kind of work on items that can be pickled.

    Attributes:
        load: from an item to what computing needs, on the CPU.
        compute: from the item, what was loaded and the device to the value.
    """

    load: Callable[[Any], Any]
    compute: Callable[[Any, Any, str], Any]


class LookItem(NamedTuple):
    """A cloud to be looked at; arguments as ``look_at``'s."""

    source: CloudSource
    voxel: float | None
    scaled: bool


class DeriveItem(NamedTuple):
    """A pair whose options are to be derived from its own two clouds."""

    source: CloudSource
    target: CloudSource


class DescribeItem(NamedTuple):
    """A cloud to be described.

    Attributes:
        source: where it is read.
        digest: what it is expected to hold.
        options: what describing depends on.
        file: where its description is kept.
    """

    source: CloudSource
    digest: str
    options: RegistrationOptions
    file: str


class PairItem(NamedTuple):
    """One pair of a slice: its options, both of its clouds, and which of them have colors."""

    pair: Pair
    options: RegistrationOptions
    source: DescribeItem
    target: DescribeItem
    colored: tuple[bool, bool]
    told: Told


Slice = tuple[PairItem, ...]
"""Pairs that go together: alike in options but for lengths, and in which clouds have colors."""


def _look(item: LookItem, cloud: Clouds, device: str) -> Look:
    return look_at(cloud, item.voxel, scaled=item.scaled)


def _load_look(item: LookItem) -> Clouds:
    return read_source(item.source)


def _load_pair(item: DeriveItem) -> tuple[Clouds, Clouds]:
    return read_source(item.source), read_source(item.target)


def _derive(item: DeriveItem, clouds: tuple[Clouds, Clouds], device: str) -> RegistrationOptions:
    return derive_options(*clouds)[0]


def _load_cloud(item: DescribeItem) -> Clouds:
    cloud = read_source(item.source)
    same = digest_of(cloud) == item.digest
    expect(same, item.source.path, "the cloud that it held when the run looked at it", "another, changed since")
    return replace(cloud, normals=None)


def _describe(item: DescribeItem, cloud: Clouds, device: str) -> int:
    return len(_described(item, cloud, device).cloud.points)


def _load_slice(item: Slice) -> dict[str, DescribedClouds | Clouds]:
    """The described clouds of a slice by their files; where a file is missing or damaged, the cloud itself."""
    clouds = {side.file: side for pair in item for side in (pair.source, pair.target)}
    return {file: read_described(Path(file)) or _load_cloud(side) for file, side in clouds.items()}


def _described(item: DescribeItem, loaded: DescribedClouds | Clouds, device: str) -> DescribedClouds:
    """A description that was kept, or is made again and kept now."""
    if isinstance(loaded, DescribedClouds):
        return loaded.to(device)
    described = describe_clouds(loaded.to(device), item.options)
    write_described(Path(item.file), described.to("cpu"))
    return described


def _register(item: Slice, loaded: dict[str, DescribedClouds | Clouds], device: str) -> list[Row]:
    """The rows of a slice."""
    wanted = {side.file: side for pair in item for side in (pair.source, pair.target)}
    ready = {file: _described(side, loaded[file], device) for file, side in wanted.items()}
    sides = [DescribedClouds.pack([ready[getattr(pair, side).file] for pair in item]) for side in ("source", "target")]
    settings = item[0].pair.settings
    result = register_described(sides[0], sides[1], [pair.options for pair in item], seed=settings.seed)
    return [
        row_of(pair.pair, result, b, source=sides[0].cloud.select(b), told=pair.told) for b, pair in enumerate(item)
    ]


LOOK = Job(_load_look, _look)
DERIVE = Job(_load_pair, _derive)
DESCRIBE = Job(_load_cloud, _describe)
REGISTER = Job(_load_slice, _register)


def load_and_compute(job: Job, device: str, item: Any) -> Outcome:  # noqa: ANN401
    """Both halves of a job in one process."""
    return attempt(lambda: job.compute(item, job.load(item), device))
