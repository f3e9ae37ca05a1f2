"""E57, by pye57 (libE57Format): many scans a file, each in a frame of its own that a pose moves to that of the file.

A scan's points get its pose applied, in double precision. Where the pose has a translation, or the coordinates are
spherical, the scanner is known: it stands at the zero of the scan's own frame. A scan without a pose is in the frame of
the file already, and where its scanner stood is not known, unless the element that ``write_e57`` adds says so.

ASTM E2807, Standard Specification for 3D Imaging Data Exchange.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.io.assemble import RawCloud
from torchreg.io.checks import refuse, require
from torchreg.io.e57_writer import VIEWPOINT_ELEMENT, VIEWPOINT_PREFIX
from torchreg.io.foreign import package, refusing
from torchreg.io.placement import Scanner, scanner_of_file
from torchreg.io.stream import CHUNK_ROWS, ScanStream
from torchreg.io.thin import CloudRows
from torchreg.io.viewpoint_line import scanner_of_line

_KIND = "an E57 file that pye57 reads"
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLORS = ("colorRed", "colorGreen", "colorBlue")
_NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
_INTENSITY = "intensity"
_INVALID = ("cartesianInvalidState", "sphericalInvalidState")
_BRIGHTEST = 65535.0  # a maximum above it declares nothing


@dataclass(frozen=True, eq=False, kw_only=True)
class _Fields:
    """What the points of a scan have."""

    coordinates: tuple[str, ...]
    invalid: str | None
    colors: bool
    normals: bool
    intensity: bool

    @property
    def names(self) -> list[str]:
        """All fields that are read."""
        parts = [*self.coordinates, *(_COLORS if self.colors else ()), *(_NORMALS if self.normals else ())]
        return [*parts, *([_INTENSITY] if self.intensity else []), *([self.invalid] if self.invalid else [])]


def read_e57(path: Path) -> Iterator[ScanStream]:
    """Read the scans of an E57 file; fields of extensions other than normals are ignored.

    Raises:
        CloudFileError: not an E57 file, a wrong checksum, no scan, a scan without coordinates, fewer points than it
            declares.
    """
    pye57 = package(path, "pye57", "pye57")
    with refusing(path, _KIND):
        file = pye57.E57(str(path))
        count = len(file.data3d) if file.root.isDefined("data3D") else 0
    require(count > 0, path, "at least one scan", "none")
    for number in range(count):
        with refusing(path, f"scan {number} of an E57 file"):
            stream = _scan(path, pye57.libe57, file, number)
        yield stream


def _scan(path: Path, libe57: Any, file: Any, number: int) -> ScanStream:  # noqa: ANN401
    scan = file.data3d[number]
    points = scan["points"]
    prototype = libe57.StructureNode(points.prototype())
    fields = _fields(path, number, {prototype.get(k).elementName() for k in range(prototype.childCount())})
    pose = _pose(path, scan)
    T = np.eye(4) if pose is None else pose
    moved = pose is not None and bool(pose[:3, 3].any())
    known = moved or fields.coordinates == _SPHERICAL
    scanner = scanner_of_file(T[:3, 3].copy(), assumed=False) if known else None
    head = RawCloud(
        name=str(path),
        format=f"e57, scan {number}, {'spherical' if fields.coordinates == _SPHERICAL else 'cartesian'}",
        points=np.empty((0, 3)),
        scanner=_written_scanner(file, scan) or scanner,
        scan=_text(scan, "name"),
        pose=pose,
    )
    rows = int(points.childCount())
    return ScanStream(
        head=head,
        rows=rows,
        chunks=lambda: _chunks(path, libe57, file, number, fields, T),
        white=_white(scan, prototype) if fields.colors else None,
    )


def _fields(path: Path, number: int, names: set[str]) -> _Fields:
    coordinates = next((one for one in (_CARTESIAN, _SPHERICAL) if set(one) <= names), None)
    if coordinates is None:
        refuse(path, f"Cartesian or spherical coordinates in scan {number}", ", ".join(sorted(names)) or "no fields")
    invalid = _INVALID[coordinates == _SPHERICAL]
    return _Fields(
        coordinates=coordinates,
        invalid=invalid if invalid in names else None,
        colors=set(_COLORS) <= names,
        normals=set(_NORMALS) <= names,
        intensity=_INTENSITY in names,
    )


def _chunks(
    path: Path,
    libe57: Any,  # noqa: ANN401
    file: Any,  # noqa: ANN401
    number: int,
    fields: _Fields,
    T: NDArray[Any],
) -> Iterator[CloudRows]:
    with refusing(path, f"the points of scan {number}"):
        points = file.data3d[number]["points"]
        declared, rows = int(points.childCount()), 0
        if declared == 0:
            return
        size = min(CHUNK_ROWS, declared)
        arrays = {name: np.zeros(size) for name in fields.names}
        buffers = libe57.VectorSourceDestBuffer()
        for name, array in arrays.items():
            buffers.append(libe57.SourceDestBuffer(file.image_file, name, array, size, True, True))
        reader = points.reader(buffers)
        try:
            while (got := int(reader.read())) > 0:
                rows += got
                yield _rows({name: array[:got].copy() for name, array in arrays.items()}, fields, T)
        finally:
            reader.close()
    require(rows == declared, path, f"{declared} points in scan {number}, as it declares", f"{rows}")


def _rows(arrays: dict[str, NDArray[Any]], fields: _Fields, T: NDArray[Any]) -> CloudRows:
    """The valid points of a chunk in the frame of the file."""
    local = np.stack([arrays[name] for name in fields.coordinates], axis=1)  # (n, 3)
    if fields.coordinates == _SPHERICAL:
        local = _from_spherical(local)
    R, t = T[:3, :3], T[:3, 3]
    is_identity = np.array_equal(T, np.eye(4))
    normals = np.stack([arrays[name] for name in _NORMALS], axis=1) if fields.normals else None
    rows = CloudRows(
        local if is_identity else np.einsum("ni,ji->nj", local, R) + t,  # by elements: the same bits for any chunk
        np.stack([arrays[name] for name in _COLORS], axis=1) if fields.colors else None,
        normals if normals is None or is_identity else np.einsum("ni,ji->nj", normals, R),
        arrays[_INTENSITY] if fields.intensity else None,
    )
    if fields.invalid is None:
        return rows
    valid = arrays[fields.invalid] == 0  # 1: only a direction; 2: nothing
    return rows if valid.all() else rows.where(valid)._replace(left_out=int((~valid).sum()))


def _from_spherical(values: NDArray[Any]) -> NDArray[Any]:
    """Range, azimuth, elevation (n, 3) in meters and radians as x, y, z (n, 3)."""
    far, azimuth, elevation = values.T
    across = far * np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), far * np.sin(elevation)], axis=1)


def _pose(path: Path, scan: Any) -> NDArray[Any] | None:  # noqa: ANN401
    """``T_file_scan`` (4, 4), or ``None`` without a pose; what it lacks is no rotation or no translation."""
    if not scan.isDefined("pose"):
        return None
    pose, T = scan["pose"], np.eye(4)
    if pose.isDefined("rotation"):
        w, x, y, z = (_number(pose["rotation"], name) for name in "wxyz")
        length = np.sqrt(w * w + x * x + y * y + z * z)
        require(bool(np.isfinite(length)) and length > 0, path, "a quaternion in its pose", f"{w}, {x}, {y}, {z}")
        w, x, y, z = (part / length for part in (w, x, y, z))
        T[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    if pose.isDefined("translation"):
        T[:3, 3] = [_number(pose["translation"], name) for name in "xyz"]
    require(bool(np.isfinite(T).all()), path, "a finite pose", str(T[:3, 3].tolist()))
    return T


def _written_scanner(file: Any, scan: Any) -> Scanner | None:  # noqa: ANN401
    """The scanner that a file written here names; its prefix must be declared before it may be looked for."""
    image = file.image_file
    prefixes = {image.extensionsPrefix(k) for k in range(image.extensionsCount())}
    text = _text(scan, VIEWPOINT_ELEMENT) if VIEWPOINT_PREFIX in prefixes else None
    return scanner_of_line((text or "").split())


def _white(scan: Any, prototype: Any) -> float | None:  # noqa: ANN401
    """The largest color that the limits of the scan declare, or its fields do."""
    if scan.isDefined("colorLimits"):
        limits = scan["colorLimits"]
        names = [f"{name}Maximum" for name in _COLORS]
        if all(limits.isDefined(name) for name in names):
            largest = max(_number(limits, name) for name in names)
            if 0 < largest <= _BRIGHTEST:
                return largest
    largest = max(float(prototype[name].maximum()) for name in _COLORS)
    return largest if 0 < largest <= _BRIGHTEST else None


def _number(node: Any, name: str) -> float:  # noqa: ANN401
    """The number of a child node: scaled integers call it otherwise."""
    child = node[name]
    return float(child.scaledValue() if hasattr(child, "scaledValue") else child.value())


def _text(node: Any, name: str) -> str | None:  # noqa: ANN401
    return str(node[name].value()) or None if node.isDefined(name) else None
