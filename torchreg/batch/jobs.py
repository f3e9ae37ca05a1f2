"""The three kinds of work of a batch: look at a cloud, describe it, register a slice of pairs.

Each is loading, which reads files and needs a processor alone, and computing, which may run on another device.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

from torchreg.batch.clouds import CloudSource, Look, digest_of, look_at, read_source
from torchreg.batch.described_file import read_described, write_described
from torchreg.batch.outcome import Outcome, attempt
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Row, Told, row_of
from torchreg.errors import expect
from torchreg.registration import DescribedClouds, describe_clouds, register_described
from torchreg.types import Clouds, RegistrationOptions


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


class DescribeItem(NamedTuple):
    """A cloud to be described.

    Attributes:
        source: where it is read.
        digest: what it is expected to hold.
        options: what describing depends on.
        file: where its description is kept.
        max_bytes: to work with.
    """

    source: CloudSource
    digest: str
    options: RegistrationOptions
    file: str
    max_bytes: int


class PairItem(NamedTuple):
    """One pair of a slice: its options and both of its clouds."""

    pair: Pair
    options: RegistrationOptions
    source: DescribeItem
    target: DescribeItem
    told: Told


Slice = tuple[PairItem, ...]
"""Pairs that go together: alike in options but for lengths, and in which clouds have colors."""


def _look(item: LookItem, cloud: Clouds, device: str) -> Look:
    return look_at(cloud, item.voxel, scaled=item.scaled)


def _load_look(item: LookItem) -> Clouds:
    return read_source(item.source)


def _load_cloud(item: DescribeItem) -> Clouds:
    cloud = read_source(item.source)
    same = digest_of(cloud) == item.digest
    expect(same, item.source.path, "the cloud that it held when the run looked at it", "another, changed since")
    return replace(cloud, normals=None)


def _describe(item: DescribeItem, cloud: Clouds, device: str) -> int:
    described = describe_clouds(cloud.to(device), item.options, max_bytes=item.max_bytes)
    write_described(Path(item.file), described.to("cpu"))
    return len(described.cloud.points)


def _load_slice(item: Slice) -> dict[str, DescribedClouds]:
    """The described clouds of a slice by their files; those that are missing or damaged are made again."""
    clouds = {side.file: side for pair in item for side in (pair.source, pair.target)}
    return {file: _load_described(side) for file, side in clouds.items()}


def _load_described(item: DescribeItem) -> DescribedClouds:
    described = read_described(Path(item.file))
    if described is None:
        _describe(item, _load_cloud(item), "cpu")
        described = read_described(Path(item.file))
    if described is None:
        raise OSError(f"{item.file}: expected the description that was just written there, got another")
    return described


def _register(item: Slice, loaded: dict[str, DescribedClouds], device: str) -> list[Row]:
    """The rows of a slice. Where it fails as a whole, pair by pair, so that one pair cannot fail the others."""
    found = attempt(_register_together, item, loaded, device)
    if not found.reason:
        rows: list[Row] = found.value
        return rows
    if found.no_room or len(item) == 1:
        raise OSError(found.reason) if found.expected else RuntimeError(found.reason)
    rows = []
    for pair in item:
        alone = attempt(_register_together, (pair,), loaded, device)
        rows += alone.value if not alone.reason else [Row.failed(pair.pair, alone.reason, expected=alone.expected)]
    return rows


def _register_together(item: Slice, loaded: dict[str, DescribedClouds], device: str) -> list[Row]:
    sides = [
        DescribedClouds.pack([loaded[getattr(pair, side).file] for pair in item]).to(device)
        for side in ("source", "target")
    ]
    settings = item[0].pair.settings
    result = register_described(sides[0], sides[1], [pair.options for pair in item], seed=settings.seed)
    return [
        row_of(pair.pair, result, b, source=sides[0].cloud.select(b), told=pair.told) for b, pair in enumerate(item)
    ]


LOOK = Job(_load_look, _look)
DESCRIBE = Job(_load_cloud, _describe)
REGISTER = Job(_load_slice, _register)


def said_of(options: RegistrationOptions) -> str:
    """All options as one text."""
    return json.dumps(asdict(options), sort_keys=True)


def load_and_compute(job: Job, device: str, item: Any) -> Outcome:  # noqa: ANN401
    """Both halves of a job in one process."""
    return attempt(lambda: job.compute(item, job.load(item), device))
