"""Read a cloud from a file, and write one; what the file is like follows from its suffix (``formats``)."""

from __future__ import annotations

import os
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchreg.errors import CloudFileError, expect
from torchreg.geometry.se3 import transform
from torchreg.io.assemble import CloudFile, assemble, checked_dtype
from torchreg.io.atomic import atomic_write
from torchreg.io.checks import readable_file, refuse, require
from torchreg.io.formats import READERS, WRITERS, alternatives
from torchreg.io.placement import Viewpoint, checked_viewpoint
from torchreg.io.transform_text import checked_rigid
from torchreg.types import Clouds


def read_cloud(
    path: str | os.PathLike[str], *, viewpoint: Viewpoint = "auto", dtype: torch.dtype = torch.float32
) -> Clouds:
    """Read a colored point cloud from a file, such as PLY, PCD or npz.

    Coordinates are read in float64. Where the median point lies more than 1 km from the frame's zero (UTM
    and other national grids), it is rounded to meters and kept as ``origin``; ordinary scans keep origin 0.
    Points with NaN or infinity are dropped. Colors become [0, 1] whatever their depth, normals unit length.

    Args:
        path: a file ``.ply`` (text, little or big endian), ``.pcd`` (text, binary, compressed) or ``.npz``
            (arrays points, and where there are any colors, normals, origin, viewpoint).
        viewpoint: where the scanner stood. "auto" takes the file's own (VIEWPOINT of PCD where it is not
            zero, the key of npz, the comment that ``write_cloud`` leaves in PLY). Where the file says nothing, it
            assumes the frame's zero, unless the points are more than ten times their extent away from it: this
            guess is marked by ``viewpoint_assumed`` and is no evidence for or against a pose. "origin" is the
            frame's zero, known; ``None`` means that nothing is known; three numbers are a known position in the
            file's frame, in meters.
        dtype: of the result, float32 or float64.

    Returns:
        A batch of one cloud on the CPU; its viewpoint is relative to its origin, and known or assumed as above.

    Raises:
        CloudFileError: the file is missing, of another kind, cut short, contradicts itself, or holds colors
            or coordinates that cannot be meant.
        ValueError: ``viewpoint`` or ``dtype`` is none of these.

    Example:
        >>> import tempfile, torchreg.io
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     torchreg.io.write_cloud(f"{folder}/a.ply", Clouds(torch.rand(5, 3)))
        ...     read_cloud(f"{folder}/a.ply").lengths
        [5]
    """
    return read_cloud_report(path, viewpoint=viewpoint, dtype=dtype).cloud


def read_cloud_report(
    path: str | os.PathLike[str], *, viewpoint: Viewpoint = "auto", dtype: torch.dtype = torch.float32
) -> CloudFile:
    """Read a cloud as ``read_cloud`` does, and report what the file holds; arguments and errors are the same."""
    wanted, dtype = checked_viewpoint(viewpoint), checked_dtype(dtype)
    file = readable_file(path)
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        refuse(file, "a name that ends in " + ", ".join(READERS), repr(file.suffix))
    with np.errstate(invalid="ignore"):  # a signaling NaN warns when it is cast
        scans = list(islice(reader(file), 2))
    require(len(scans) == 1, file, "a file of one scan", "one of several" if scans else "one without any")
    try:
        return assemble(scans[0], wanted, dtype)
    except ValueError as error:
        raise CloudFileError(str(error)) from None


def write_cloud(path: str | os.PathLike[str], cloud: Clouds, *, T: Tensor | None = None) -> None:
    """Write one cloud as binary PLY or as npz, in full or not at all.

    PLY holds the coordinates with the origin added, in double precision where the cloud has an origin other
    than zero, coordinates beyond 1 km, or float64 points; colors in 8 bits; the viewpoint in a comment that
    ``read_cloud`` understands. npz holds the arrays as they are, the origin apart: nothing is rounded. Both keep
    whether the viewpoint is known or assumed.

    Args:
        path: a name that ends in ``.ply`` or ``.npz``.
        cloud: a batch of one.
        T: (4, 4) rigid, ``T_to_from``, origins included; applied in float64 to points, normals and viewpoint
            first. With a result's ``T_target_source[0]`` this writes the source aligned to the target.

    Raises:
        ValueError: another suffix, a batch of several clouds, a matrix that is not rigid, no such folder.
    """
    writer = WRITERS.get(Path(path).suffix.lower())
    if writer is None:
        raise ValueError(f"path: expected a name that ends in {alternatives(WRITERS)}, got {os.fspath(path)!r}")
    expect(len(cloud) == 1, "cloud", "a batch of one (cloud.select(b) picks one)", f"{len(cloud)} clouds")
    wide = cloud.to(device="cpu", dtype=torch.float64)
    if T is not None:
        wide = transform(wide, torch.from_numpy(checked_rigid(T, "T")))
    with atomic_write(path) as file:
        writer(file, wide, cloud.points.dtype)
