"""A cloud as numpy's ``.npz``: the arrays of ``Clouds`` under their names, nothing rounded.

    points (N, 3)   colors (N, 3)   normals (N, 3)   origin (3,)   viewpoint (3,)   viewpoint_known ()

As in ``Clouds``, points and viewpoint are relative to the origin (zeros where there is none). A viewpoint of
NaN says that it is not known; a ``viewpoint_known`` of false, that it is only assumed. A viewpoint without this
array is known. Pickled objects are never loaded.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.errors import CloudFileError
from torchreg.io.assemble import RawCloud
from torchreg.io.checks import excerpt, refuse, require
from torchreg.io.placement import Scanner, scanner_of_file, viewpoint_or_nan
from torchreg.types import Clouds

_FLAG = "viewpoint_known"
_KEYS = ("points", "colors", "normals", "origin", "viewpoint", _FLAG)
_UNREADABLE = (ValueError, OSError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error)


def read_npz(path: Path) -> Iterator[RawCloud]:
    """Read a cloud from a ``.npz`` file.

    Raises:
        CloudFileError: not a zip file of arrays, no points, another shape, no real numbers, pickled objects,
            an array shorter than its header says.
    """
    require(zipfile.is_zipfile(path), path, "an .npz file, which is a zip file", "another kind of file")
    try:
        with zipfile.ZipFile(path) as archive:
            members = {name.removesuffix(".npy"): name for name in archive.namelist()}
            arrays = {key: _array(path, archive, members[key], key) for key in _KEYS if key in members}
    except CloudFileError:
        raise
    except _UNREADABLE as error:
        refuse(path, "an .npz file of arrays", f"{type(error).__name__}: {excerpt(str(error))}")
    if "points" not in arrays:
        refuse(path, "an array 'points'", ", ".join(map(repr, members)) or "no arrays")
    points = arrays["points"]
    shaped = points.ndim == 2 and points.shape[1] == 3 and len(points) > 0
    require(shaped, path, "points of shape (N, 3), N at least 1", str(points.shape))
    for key in ("colors", "normals"):
        shape = arrays[key].shape if key in arrays else points.shape
        require(shape == points.shape, path, f"{key} of the shape of points, {points.shape}", str(shape))
    origin = _position(path, arrays, "origin")
    origin = np.zeros(3) if origin is None else origin
    require(bool(np.isfinite(origin).all()), path, "a finite origin", str(origin))
    yield RawCloud(
        name=str(path),
        format="npz",
        points=points.astype(np.float64),
        colors=arrays.get("colors"),
        normals=arrays["normals"].astype(np.float64) if "normals" in arrays else None,
        origin=origin,
        scanner=_scanner(path, arrays),
    )


def write_npz(file: BinaryIO, cloud: Clouds, dtype: torch.dtype) -> None:
    """Write the arrays of one cloud in the dtype that the caller has it in."""
    cloud = cloud.to(dtype=dtype)
    arrays = {
        "points": cloud.points,
        "origin": cloud.origin[0],
        "viewpoint": viewpoint_or_nan(cloud),
        _FLAG: cloud.viewpoint_known[0],
    }
    optional = {"colors": cloud.colors, "normals": cloud.normals}
    arrays.update({key: value for key, value in optional.items() if value is not None})
    np.savez(file, **{key: value.detach().numpy() for key, value in arrays.items()})  # type: ignore[arg-type]


def _array(path: Path, archive: zipfile.ZipFile, member: str, key: str) -> NDArray[Any]:
    """One array, once its header agrees with the size of its member: numpy allocates before it reads."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(version)
        if read_header is None:
            refuse(path, f"{key} in numpy's format 1.0 or 2.0", str(version))
        shape, _, dtype = read_header(file)
        kinds, words = ("b", "true or false") if key == _FLAG else ("iuf", "real numbers")
        require(dtype.kind in kinds, path, f"{key} of {words}", str(dtype))
        size, stored = math.prod(shape) * dtype.itemsize, archive.getinfo(member).file_size - file.tell()
        require(size == stored, path, f"{key} {shape} of {size} bytes, as its header declares", f"{stored}")
    with archive.open(member) as file:
        array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def _scanner(path: Path, arrays: dict[str, NDArray[Any]]) -> Scanner | None:
    """What the arrays say of the scanner; ``None`` without a viewpoint."""
    known = arrays.get(_FLAG, np.array(True))
    require(known.size == 1, path, f"{_FLAG} of shape ()", str(known.shape))
    viewpoint = _position(path, arrays, "viewpoint")
    return None if viewpoint is None else scanner_of_file(viewpoint, assumed=not known.all())


def _position(path: Path, arrays: dict[str, NDArray[Any]], key: str) -> NDArray[Any] | None:
    if key not in arrays:
        return None
    value = arrays[key]
    require(value.shape in ((3,), (1, 3)), path, f"{key} of shape (3,)", str(value.shape))
    return value.reshape(3).astype(np.float64)
