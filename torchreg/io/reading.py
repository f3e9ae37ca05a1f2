"""How a file is read: which of its scans, what its columns and units are, and how it is thinned on the way."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np
import torch

from torchreg.arguments import checked_record
from torchreg.errors import CloudFileError, at_least, expect, positive
from torchreg.io.assemble import CloudFile, RawCloud, assemble, checked_dtype
from torchreg.io.checks import readable_file, refuse
from torchreg.io.formats import COLUMN_READERS, READERS, Scan
from torchreg.io.gray import with_gray_colors
from torchreg.io.placement import Viewpoint, checked_viewpoint
from torchreg.io.stream import Progress, ScanStream, Thinning, collect, in_meters, stream_of
from torchreg.io.units import checked_units, meters_of, unit_note
from torchreg.io.unreadable import refuse_suffix

_NAMED_SCANS = 8  # that a message lists


@checked_record
@dataclass(frozen=True, kw_only=True)
class Reading:
    """How a file is read.

    Attributes:
        viewpoint: where the scanner stood, as for ``read_cloud``.
        dtype: of the clouds, float32 or float64.
        columns: what the columns of a text file are, such as "x y z intensity red green blue"; ``None`` finds them.
        units: of the file: a key of ``units.METERS``, "file" for the one that it names, ``None`` for meters.
        voxel: meters, edge of cubes in which points are averaged while they are read; ``None`` keeps all points.
        at_most: points that are kept as they are; a larger scan is thinned while it is read, by cubes of ``voxel``,
            or of a size that follows from its extent, which double until no more than this many are left.
        intensity: whether the intensity becomes gray colors where there are no colors.

    Raises:
        ValueError: an invalid option; the message names it.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.write_cloud("a.ply", tr.Clouds(torch.rand(1000, 3)))
        >>> file = tr.io.read_cloud_report("a.ply", reading=tr.io.Reading(units="mm", voxel=0.0005))
        >>> len(file.cloud.points) < 1000
        True
    """

    viewpoint: Viewpoint = "auto"
    dtype: torch.dtype = torch.float32
    columns: str | None = None
    units: str | None = None
    voxel: float | None = None
    at_most: int | None = None
    intensity: bool = False
    thinning: Thinning = field(init=False, repr=False)

    def __post_init__(self) -> None:
        checked_viewpoint(self.viewpoint)
        checked_dtype(self.dtype)
        checked_units(self.units)
        if self.voxel is not None:
            positive(self.voxel, "voxel")
        if self.at_most is not None:
            at_least(self.at_most, "at_most", 1)
        object.__setattr__(self, "thinning", Thinning(voxel=self.voxel, at_most=self.at_most))


def scans_of(path: str | os.PathLike[str], columns: str | None = None) -> list[Scan]:
    """The scans of a file, their points not yet read where the format allows it.

    Raises:
        CloudFileError: the file cannot be read, or it has no columns to name.
    """
    file = readable_file(path)
    suffix = file.suffix.lower()
    reader = READERS.get(suffix)
    if reader is None:
        refuse_suffix(file, READERS)
    with np.errstate(invalid="ignore", over="ignore"):  # a signaling NaN or a long double warns when it is cast
        if columns is None:
            return list(reader(file))
        named = COLUMN_READERS.get(suffix)
        if named is None:
            refuse(file, "no columns= for a file that names its columns itself", repr(columns))
        return list(named(file, columns))


def chosen_scan(path: Path, scans: list[Scan], scan: int | str | None) -> Scan:
    """The only scan, or the one of this number, counted from 0, or name.

    Raises:
        CloudFileError: several scans and none chosen, no such scan, or a name that several have.
    """
    names = [_head(one).scan for one in scans]
    listed = ", ".join(f"{k} {name!r}" if name else str(k) for k, name in enumerate(islice(names, _NAMED_SCANS)))
    listed += ", ..." if len(names) > _NAMED_SCANS else ""
    count = f"a file of {len(scans)} scan{'s' * (len(scans) != 1)}{f' ({listed})' * (len(scans) > 0)}"
    if scan is None:
        if len(scans) != 1:
            refuse(path, "one scan, or scan= to choose one", count)
        return scans[0]
    places = [k for k, name in enumerate(names) if name == scan]
    if len(places) > 1:
        refuse(path, f"one scan of the name {scan!r}", f"several in {count}: give its number")
    if not places:
        number = int(scan) if isinstance(scan, int) or (scan.isascii() and scan.isdigit()) else -1
        if not 0 <= number < len(scans):
            refuse(path, f"a scan {scan!r}, by number or name", count)
        places = [number]
    return scans[places[0]]


def finished(path: Path, scan: Scan, reading: Reading, progress: Progress | None = None) -> CloudFile:
    """Read the points of a scan and make it a cloud.

    Raises:
        CloudFileError: the file cannot be read as a cloud.
    """
    head = _head(scan)
    meters = meters_of(reading.units, head.unit)
    try:
        with np.errstate(invalid="ignore"):
            if isinstance(scan, ScanStream) or reading.thinning.is_asked_for:
                stream = stream_of(scan) if isinstance(scan, RawCloud) else scan
                raw = collect(stream, thinning=reading.thinning, meters=meters, progress=progress)
            else:
                raw = in_meters(scan, meters)
        raw = replace(raw, notes=(*raw.notes, *unit_note(reading.units, head.unit)))
        raw = with_gray_colors(raw, asked_for=reading.intensity)
        return assemble(raw, checked_viewpoint(reading.viewpoint), reading.dtype)
    except CloudFileError:
        raise
    except ValueError as error:
        text = str(error)
        raise CloudFileError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def with_points(path: Path, scans: Iterable[Scan]) -> tuple[list[tuple[int, Scan]], tuple[str, ...]]:
    """The scans that have points, by number, and notes on those that have none.

    Raises:
        CloudFileError: no scan has points.
    """
    numbered = list(enumerate(scans))
    full = [(k, scan) for k, scan in numbered if not (isinstance(scan, ScanStream) and scan.rows == 0)]
    if not full:
        refuse(path, "a scan with points", f"none among {len(numbered)}")
    there = {k for k, _ in full}
    lost = ", ".join(str(k) for k, _ in numbered if k not in there)
    return full, (f"left out, since they have no points: scans {lost} of {len(numbered)}",) * bool(lost)


def checked_scan(scan: int | str | None) -> int | str | None:
    """Return ``scan`` if it is a number, a name or ``None``, else raise ``ValueError``."""
    legal = scan is None or (isinstance(scan, int | str) and not isinstance(scan, bool))
    expect(legal, "scan", "the number of a scan, counted from 0, its name, or None", scan)
    return scan


def _head(scan: Scan) -> RawCloud:
    return scan.head if isinstance(scan, ScanStream) else scan
