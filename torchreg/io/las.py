"""LAS, LAZ and COPC, by laspy and lazrs.

Colors have 16 bits; many programs write 8 of them, which shows in the largest. The unit is that of the coordinate
system where the file names one.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import excerpt, require
from torchreg.io.foreign import package, refusing
from torchreg.io.stream import CHUNK_ROWS, ScanStream
from torchreg.io.thin import CloudRows

_KIND = "a LAS or LAZ file that laspy reads"
_OLD_HEADER, _HEADER = 227, 375  # bytes, of versions 1.0 and 1.4
_RECORD, _EXTENDED_RECORD = 54, 60  # bytes before what they hold
_CHUNK_BYTES = 1 << 25
_COMPRESSED = 0x80  # of the point format
_UNIT_KEYS = (3076, 4099)  # of GeoTIFF: across, upwards
_GEOTIFF_UNITS = {9001: "m", 9002: "ft", 9003: "us-ft"}
_WKT_UNIT = re.compile(r'UNIT\["[^"]*",(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)')
_LARGEST_ANGLE = 0.1  # radians in a degree or a gon, rounded up
_WKT_METERS = ((1.0, "m"), (0.3048, "ft"), (1200 / 3937, "us-ft"))


def read_las(path: Path) -> Iterator[ScanStream]:
    """Read the points of a LAS, LAZ or COPC file, with colors and intensity where any of them is not 0.

    Raises:
        CloudFileError: not such a file, one that laspy cannot read, or fewer points than its header declares.
    """
    _check_sizes(path)
    laspy = package(path, "laspy", "'laspy[lazrs]'")
    with refusing(path, _KIND), laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as file:
        header = file.header
        dimensions = set(header.point_format.dimension_names)
        rows, (unit, upwards) = int(header.point_count), _units(header)
        kind = f"las {header.version}, point format {header.point_format.id}"
    notes: tuple[str, ...] = ()
    if upwards not in (None, unit):
        notes = (
            f"the file says that its heights are in {upwards} and its other coordinates in {unit or 'another unit'}",
        )
    head = RawCloud(name=str(path), format=kind, points=np.empty((0, 3)), unit=unit, notes=notes)
    yield ScanStream(
        head=head,
        rows=rows,
        chunks=lambda: _chunks(path, laspy, rows, dimensions),
        white=65535.0 if "red" in dimensions else None,
    )


def _check_sizes(path: Path) -> None:
    """Raise ``CloudFileError`` for records that the file has no room for: laspy takes memory or time for them all."""
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(_HEADER)
        require(start[:4] == b"LASF", path, "a LAS file, which starts with 'LASF'", excerpt(start[:4]))
        require(len(start) >= _OLD_HEADER, path, f"a header of {_OLD_HEADER} bytes or more", f"{len(start)}")
        header, offset = struct.unpack_from("<HI", start, 94)
        fits = header <= offset <= size
        require(fits, path, f"points within {size} bytes, after the header", f"them at byte {offset}")
        _check_chunks(path, file, start, size)
        (records,) = struct.unpack_from("<I", start, 100)
        require(records * _RECORD <= size, path, f"{records} records after the header", f"a file of {size} bytes")
        if start[25] < 4 or len(start) < _HEADER:
            return
        place, count = struct.unpack_from("<QI", start, 235)
        for _ in range(count):
            room = size - place - _EXTENDED_RECORD
            require(room >= 0, path, f"{count} extended records, as its header declares", "fewer before its end")
            file.seek(place + 20)
            (length,) = struct.unpack("<Q", file.read(8))
            require(length <= room, path, f"an extended record of {length} bytes", f"{room} bytes before its end")
            place += _EXTENDED_RECORD + length


def _check_chunks(path: Path, file: BinaryIO, start: bytes, size: int) -> None:
    """Raise ``CloudFileError`` for more compressed chunks than the file has room for: lazrs ends the process."""
    (offset,) = struct.unpack_from("<I", start, 96)
    if not start[104] & _COMPRESSED or offset + 8 > size:
        return
    file.seek(offset)
    (table,) = struct.unpack("<q", file.read(8))
    if table == -1:  # written as a stream: its place stands last
        file.seek(size - 8)
        (table,) = struct.unpack("<q", file.read(8))
    require(0 <= table <= size - 8, path, f"a table of chunks within {size} bytes", f"one at byte {table}")
    file.seek(table + 4)
    (chunks,) = struct.unpack("<I", file.read(4))
    (length,) = struct.unpack_from("<H", start, 105)
    fits = chunks * max(length, 1) <= size  # each begins with a whole point
    require(fits, path, f"{chunks} chunks of compressed points", f"a file of {size} bytes")


def _chunks(path: Path, laspy: Any, declared: int, dimensions: set[str]) -> Iterator[CloudRows]:  # noqa: ANN401
    rows = 0
    with refusing(path, _KIND), laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as file:
        size = max(1, min(CHUNK_ROWS, declared, _CHUNK_BYTES // file.header.point_format.size))
        for points in file.chunk_iterator(size):
            xyz = np.stack([np.asarray(axis, dtype=np.float64) for axis in (points.x, points.y, points.z)], axis=1)
            colors = None
            if "red" in dimensions:
                colors = np.stack([points.red, points.green, points.blue], axis=1)
            rows += len(xyz)
            yield CloudRows(xyz, colors, None, np.asarray(points.intensity, dtype=np.float64))
    require(rows == declared, path, f"{declared} points, as its header declares", f"{rows}")


def _units(header: Any) -> tuple[str | None, str | None]:  # noqa: ANN401
    """The units across and upwards that the coordinate system names; ``None`` for one that it does not name."""
    records = [*header.vlrs, *(header.evlrs or ())]
    for record in records:
        text = getattr(record, "string", None)
        if isinstance(text, str) and text.strip("\0 "):
            return _units_of_wkt(text)
    keys = {key.id: int(key.value_offset) for record in records for key in getattr(record, "geo_keys", ())}
    across, upwards = (_GEOTIFF_UNITS.get(keys.get(key, 0)) for key in _UNIT_KEYS)
    return across, upwards


def _units_of_wkt(text: str) -> tuple[str | None, str | None]:
    """Likewise in a coordinate system as text, of either version; units of angles are far below a foot."""
    flat = "".join(text.split())
    if "CS[Cartesian" in flat:  # version 2: the unit follows the axes
        across, _, upwards = flat.partition("CS[Cartesian")[2].partition("CS[vertical")
        return _unit_named(across, 0), _unit_named(upwards, 0)
    across, _, upwards = flat.partition("VERT_CS[")  # version 1: it is the last of the projected system
    return _unit_named(across, -1) if "PROJCS[" in across else None, _unit_named(upwards, -1)


def _unit_named(text: str, place: int) -> str | None:
    sizes = [size for word in _WKT_UNIT.findall(text) if (size := float(word)) > _LARGEST_ANGLE]
    near = (name for meters, name in _WKT_METERS if sizes and abs(sizes[place] - meters) < 1e-8)
    return next(near, None)
