"""Read a cloud from a file."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from torchreg.errors import CloudFileError
from torchreg.io.assemble import assemble, checked_dtype
from torchreg.io.checks import readable_file, refuse
from torchreg.io.npz import read_npz
from torchreg.io.pcd import read_pcd
from torchreg.io.placement import Viewpoint, checked_viewpoint
from torchreg.io.ply import read_ply
from torchreg.io.raw_cloud import RawCloud
from torchreg.types import Clouds

CLOUD_SUFFIXES = (".ply", ".pcd", ".npz")
"""What names of clouds end in."""

_READERS: dict[str, Callable[[Path], RawCloud]] = {".ply": read_ply, ".pcd": read_pcd, ".npz": read_npz}


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudFile:
    """A cloud and what reading it showed.

    Attributes:
        cloud: a batch of one.
        path: the file.
        format: such as "ply binary_little_endian".
        points_in_file: before points were dropped.
        dropped_non_finite: points with NaN or infinity among their coordinates.
        has_colors: whether the cloud has colors.
        color_depth: "uint8", "uint16" or "float" in the file; ``None`` without colors.
        has_normals: whether the cloud has normals.
        viewpoint_source: where the scanner's position is known from, in words.
        extent: edges of the bounding box along x, y, z, in meters.
        notes: what a user should know, such as colors that had to be guessed at.
    """

    cloud: Clouds
    path: str
    format: str
    points_in_file: int
    dropped_non_finite: int
    has_colors: bool
    color_depth: str | None
    has_normals: bool
    viewpoint_source: str
    extent: tuple[float, float, float]
    notes: tuple[str, ...]


def read_cloud(
    path: str | os.PathLike[str], *, viewpoint: Viewpoint = "auto", dtype: torch.dtype = torch.float32
) -> Clouds:
    """Read a colored point cloud from a PLY, PCD or npz file.

    Coordinates are read in float64. Where the median point lies more than 1 km from the frame's zero (UTM
    and other national grids), it is rounded to meters and kept as ``origin``; ordinary scans keep origin 0.
    Points with NaN or infinity are dropped. Colors become [0, 1] whatever their depth, normals unit length.

    Args:
        path: a file ``.ply`` (text, little or big endian), ``.pcd`` (text, binary, compressed) or ``.npz``
            (arrays points, and where there are any colors, normals, origin, viewpoint).
        viewpoint: where the scanner stood. "auto" takes the file's own (VIEWPOINT of PCD where it is not
            zero, the key of npz, the comment that ``write_cloud`` leaves in PLY), else the frame's zero,
            unless the points are more than ten times their extent away from it; "origin" is the frame's
            zero; ``None`` means not known; three numbers are a position in the file's frame, in meters.
        dtype: of the result, float32 or float64.

    Returns:
        A batch of one cloud on the CPU; its viewpoint is relative to its origin.

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
    """Read a cloud as ``read_cloud`` does, and say what was found; arguments and errors are the same."""
    wanted, dtype = checked_viewpoint(viewpoint), checked_dtype(dtype)
    file = readable_file(path)
    reader = _READERS.get(file.suffix.lower())
    if reader is None:
        refuse(file, "a name that ends in " + ", ".join(_READERS), repr(file.suffix))
    with np.errstate(invalid="ignore"):  # a signaling NaN warns when it is cast
        raw = reader(file)
    try:
        found = assemble(raw, wanted, dtype)
    except ValueError as error:
        raise CloudFileError(str(error)) from None
    return CloudFile(
        cloud=found.cloud,
        path=str(file),
        format=raw.format,
        points_in_file=len(raw.points),
        dropped_non_finite=found.dropped_non_finite,
        has_colors=found.cloud.colors is not None,
        color_depth=found.color_depth,
        has_normals=found.cloud.normals is not None,
        viewpoint_source=found.viewpoint_source,
        extent=found.extent,
        notes=found.notes,
    )
