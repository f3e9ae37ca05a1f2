"""A cloud as numpy's ``.npz``: the arrays of ``Clouds`` under their names, nothing rounded.

    points (N, 3)   colors (N, 3)   normals (N, 3)   origin (3,)   viewpoint (3,)   viewpoint_known ()

As in ``Clouds``, points and viewpoint are relative to the origin (zeros where there is none). A viewpoint of
NaN says that it is not known; a ``viewpoint_known`` of false, that it is only assumed. A viewpoint without this
array is known. Pickled objects are never loaded.
"""

from __future__ import annotations

import io
import math
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from torchreg.errors import CloudFileError
from torchreg.io.assemble import RawCloud
from torchreg.io.checks import excerpt, refuse, require
from torchreg.io.placement import FARTHEST_COORDINATE, Scanner, scanner_of_file, viewpoint_or_nan
from torchreg.types import Clouds

_FLAG = "viewpoint_known"
_KEYS = ("points", "colors", "normals", "origin", "viewpoint", _FLAG)
_LONGEST_HEADER = 2048  # bytes of an array's header; those of the arrays that are read take 128
_FEW = 1 << 20  # points; more of them may not be packed denser than this:
_LARGEST_RATIO = 100  # ten times what points reach; a zip file can promise a thousand


class _Member(NamedTuple):
    """An array before it is read: where it is, and what its header says."""

    info: zipfile.ZipInfo
    shape: tuple[int, ...]
    dtype: np.dtype[Any]


def read_npz(path: Path) -> Iterator[RawCloud]:
    """Read a cloud from a ``.npz`` file.

    Raises:
        CloudFileError: not a zip file of arrays, no points, another shape, no real numbers, pickled objects,
            an array shorter than its header says, or points packed so densely that they can be none.
    """
    with _refusing(path):
        is_zip = zipfile.is_zipfile(path)
    require(is_zip, path, "an .npz file, which is a zip file", "another kind of file")
    with _refusing(path), zipfile.ZipFile(path) as archive:
        infos = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        members = {key: _member(path, archive, infos[key], key) for key in _KEYS if key in infos}
        if "points" not in members:
            refuse(path, "an array 'points'", ", ".join(map(repr, infos)) or "no arrays")
        _check_shapes(path, members)
        arrays = {key: _array(archive, member) for key, member in members.items()}
    origin = _position(arrays, "origin")
    origin = np.zeros(3) if origin is None else origin
    near = bool((np.abs(origin) <= FARTHEST_COORDINATE).all())
    require(near, path, f"a finite origin, up to {FARTHEST_COORDINATE:g} m", str(origin))
    yield RawCloud(
        name=str(path),
        format="npz",
        points=arrays["points"].astype(np.float64),
        colors=arrays.get("colors"),
        normals=arrays["normals"].astype(np.float64) if "normals" in arrays else None,
        origin=origin,
        scanner=_scanner(arrays),
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


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Turn what ``zipfile`` and numpy raise on damaged bytes, a dozen kinds, into one; their warnings are left out."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except CloudFileError:
        raise
    except Exception as error:
        refuse(path, "an .npz file of arrays", f"{type(error).__name__}: {excerpt(str(error))}")


def _member(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo, key: str) -> _Member:
    """The header of one array, once it agrees with the size of the array: numpy allocates before it reads."""
    packings = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others unpack a whole block, however large, at once
    require(info.compress_type in packings, path, f"{key} stored or deflated", f"packing {info.compress_type}")
    with archive.open(info) as file:
        head = io.BytesIO(file.read(_LONGEST_HEADER))
    version = np.lib.format.read_magic(head)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read_header is None:
        refuse(path, f"{key} in numpy's format 1.0 or 2.0", str(version))
    shape, _, dtype = read_header(head, max_header_size=_LONGEST_HEADER)
    kinds, words = ("b", "true or false") if key == _FLAG else ("iuf", "real numbers")
    require(dtype.kind in kinds, path, f"{key} of {words}", str(dtype))
    size, stored = math.prod(shape) * dtype.itemsize, info.file_size - head.tell()
    require(size == stored, path, f"{key} {shape} of {size} bytes, as its header declares", f"{stored}")
    return _Member(info, shape, dtype)


def _check_shapes(path: Path, members: dict[str, _Member]) -> None:
    """Refuse other shapes than those of ``Clouds``, and points that a file of this size cannot hold."""
    info, shape, dtype = members["points"]
    require(
        len(shape) == 2 and shape[1] == 3 and shape[0] > 0, path, "points of shape (N, 3), N at least 1", str(shape)
    )
    size, packed = math.prod(shape) * dtype.itemsize, min(info.compress_size, path.stat().st_size)
    dense = f"{size} bytes packed into {packed}"
    possible = shape[0] <= _FEW or size <= _LARGEST_RATIO * packed
    require(possible, path, f"points packed at most {_LARGEST_RATIO} times", dense)
    for key in ("colors", "normals"):
        other = members[key].shape if key in members else shape
        require(other == shape, path, f"{key} of the shape of points, {shape}", str(other))
    for key in ("origin", "viewpoint"):
        other = members[key].shape if key in members else (3,)
        require(other in ((3,), (1, 3)), path, f"{key} of shape (3,)", str(other))
    other = members[_FLAG].shape if _FLAG in members else ()
    require(math.prod(other) == 1, path, f"{_FLAG} of shape ()", str(other))


def _array(archive: zipfile.ZipFile, member: _Member) -> NDArray[Any]:
    with archive.open(member.info) as file:
        array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def _scanner(arrays: dict[str, NDArray[Any]]) -> Scanner | None:
    """What the arrays say of the scanner; ``None`` without a viewpoint."""
    known = arrays.get(_FLAG, np.array(True))
    viewpoint = _position(arrays, "viewpoint")
    return None if viewpoint is None else scanner_of_file(viewpoint, assumed=not known.all())


def _position(arrays: dict[str, NDArray[Any]], key: str) -> NDArray[Any] | None:
    return arrays[key].reshape(3).astype(np.float64) if key in arrays else None
