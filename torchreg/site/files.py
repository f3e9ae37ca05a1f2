"""Scans in files: looking at them, describing them, and registering pairs of them, as jobs of an engine.

What jobs hand over are texts and arrays, since thousands of small tensors between processes exhaust what these share.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch

from torchreg.batch.described_file import read_described, write_described
from torchreg.batch.engine import Job
from torchreg.errors import CloudFileError
from torchreg.io import Reading, read_cloud_report
from torchreg.io.reading import finished, scans_of, with_points
from torchreg.registration.describe import describe_by
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.same_clouds import digest_of
from torchreg.site.pairs import DescriptionKey, SitePair
from torchreg.site.panorama import Panorama, panorama_of
from torchreg.site.panorama_file import panorama_file, read_panorama, write_panorama
from torchreg.site.records import text_of_found, text_of_look
from torchreg.site.scans import look_at
from torchreg.site.sketches import Sketch, sketch_of
from torchreg.site.work import registered_slice
from torchreg.types import Clouds


class FileItem(NamedTuple):
    """A file whose scans are to be looked at."""

    path: str
    reading: Reading
    scaled: bool  # whether their scales are asked for


class SeenScan(NamedTuple):
    """A scan of a file: its number there, its name where it has one, remarks on reading it, whether the file has a
    pose for it, which its points have applied, and the look as text."""

    number: int
    name: str
    notes: tuple[str, ...]
    posed: bool
    look: str


class ScanSource(NamedTuple):
    """A scan of a file and how it is read; equal ones give equal clouds."""

    path: str
    number: int
    reading: Reading


class ScanItem(NamedTuple):
    """A scan to be described."""

    source: ScanSource
    digest: str  # what it is expected to hold
    key: DescriptionKey
    file: str  # where its description is kept


class SketchItem(NamedTuple):
    """A described scan to be sketched, as pairs of these options match it."""

    scan: ScanItem
    options: RegistrationOptions


class SliceItem(NamedTuple):
    """Pairs that are registered together, and the scans that they need."""

    pairs: tuple[SitePair, ...]
    scans: tuple[ScanItem, ...]
    seed: int


def read_scan(source: ScanSource) -> Clouds:
    """Read a scan, a batch of one on the CPU.

    Raises:
        CloudFileError: the file is missing or damaged.
    """
    return read_cloud_report(source.path, scan=source.number, reading=source.reading).cloud


class FileScans(Sequence[Clouds]):
    """The scans of files, each read when it is asked for; those that cannot be read are empty."""

    def __init__(self, sources: Sequence[ScanSource | None]) -> None:
        self._sources = sources

    def __len__(self) -> int:
        return len(self._sources)

    def __getitem__(self, scan: Any) -> Any:  # noqa: ANN401
        if isinstance(scan, slice):
            return FileScans(self._sources[scan])
        source = self._sources[scan]
        return Clouds(torch.zeros(0, 3)) if source is None else read_scan(source)

    def __iter__(self) -> Iterator[Clouds]:
        return (self[scan] for scan in range(len(self)))


def _look(item: FileItem, loaded: FileItem, device: str) -> list[SeenScan]:
    """Look at the scans of a file, one after another, so that a file of hundreds fits into memory."""
    path, seen = Path(item.path), []
    scans, notes = with_points(path, scans_of(path, item.reading.columns))
    for number, scan in scans:
        file = finished(path, scan, item.reading)
        look = text_of_look(look_at(file.cloud, scaled=item.scaled))
        seen.append(SeenScan(number, file.scan or "", (*file.notes, *notes), file.pose is not None, look))
    return seen


def _load_scan(item: ScanItem) -> Clouds:
    cloud = read_scan(item.source)
    same = digest_of(cloud) == item.digest
    if not same:
        raise CloudFileError(
            f"{item.source.path}: expected the scan that it held when the run looked at it, got another"
        )
    return cloud if item.key.colored else replace(cloud, colors=None)


def _describe(item: ScanItem, cloud: Clouds, device: str) -> int:
    return len(_described(item, cloud, device).cloud.points)


def _load_described(item: ScanItem) -> DescribedClouds | Clouds:
    """A description as it was kept; where it is missing or damaged, the scan itself."""
    return read_described(Path(item.file), item.key.description) or _load_scan(item)


def _described(item: ScanItem, loaded: DescribedClouds | Clouds, device: str) -> DescribedClouds:
    """A description as it was kept, or made again and kept now."""
    if isinstance(loaded, DescribedClouds):
        return loaded.to(device)
    described = describe_by(loaded.to(device), [item.key.description])
    write_described(Path(item.file), described.to("cpu"))
    write_panorama(panorama_file(Path(item.file)), panorama_of(loaded))
    return described


def described_scan(item: ScanItem, device: str) -> DescribedClouds:
    """The description of a scan, a batch of one."""
    return _described(item, _load_described(item), device)


def panorama_of_scan(item: ScanItem) -> Panorama | None:
    """The panorama of a scan as it was kept, or made again and kept now."""
    file = panorama_file(Path(item.file))
    kept = read_panorama(file)
    if kept is not None:
        return kept.panorama
    panorama = panorama_of(_load_scan(item))
    write_panorama(file, panorama)
    return panorama


def _load_sketched(item: SketchItem) -> DescribedClouds | Clouds:
    return _load_described(item.scan)


def _sketch(item: SketchItem, loaded: DescribedClouds | Clouds, device: str) -> tuple[Any, Any, float]:
    sketch = sketch_of(_described(item.scan, loaded, device), item.options, colored=item.scan.key.colored)
    return sketch.points.numpy(), sketch.features.numpy(), sketch.spacing


def sketch_from(value: tuple[Any, Any, float]) -> Sketch:
    """The sketch that a job handed over."""
    points, features, spacing = value
    return Sketch(torch.from_numpy(points), torch.from_numpy(features), spacing)


def _load_slice(item: SliceItem) -> list[DescribedClouds | Clouds]:
    return [_load_described(scan) for scan in item.scans]


def _register(item: SliceItem, loaded: list[DescribedClouds | Clouds], device: str) -> list[str]:
    sides = {scan.key: _described(scan, one, device) for scan, one in zip(item.scans, loaded, strict=True)}
    return [text_of_found(found) for found in registered_slice(item.pairs, sides.__getitem__, item.seed)]


def _as_it_is(item: FileItem) -> FileItem:
    return item


LOOK = Job(_as_it_is, _look)
DESCRIBE = Job(_load_scan, _describe)
SKETCH = Job(_load_sketched, _sketch)
REGISTER = Job(_load_slice, _register)
