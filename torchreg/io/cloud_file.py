"""Read a cloud from a file, and write one; what the file is like follows from its suffix (``formats``)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from torchreg.arguments import checked
from torchreg.entry import entry
from torchreg.errors import expect_in_words
from torchreg.geometry.se3 import transform
from torchreg.io.assemble import CloudFile
from torchreg.io.atomic import atomic_write
from torchreg.io.fields import PointFields
from torchreg.io.formats import FIELDS_WRITERS, SCANS_WRITERS, WRITERS, alternatives
from torchreg.io.placement import Viewpoint
from torchreg.io.posed import PosedScan
from torchreg.io.reading import Reading, checked_scan, chosen_scan, finished, scans_of, with_points
from torchreg.io.stream import Progress
from torchreg.io.transform_text import checked_rigid
from torchreg.types import Clouds


@entry
def read_cloud(
    path: str | os.PathLike[str],
    *,
    scan: int | str | None = None,
    viewpoint: Viewpoint = "auto",
    dtype: torch.dtype = torch.float32,
    columns: str | None = None,
    units: str | None = None,
    voxel: float | None = None,
    intensity: bool = False,
) -> Clouds:
    """Read a point cloud, colored or not, from a file: PLY, PCD, E57, LAS, LAZ, PTX, PTS, text, npz.

    Coordinates are read in float64. Where the median point lies more than 1 km from the frame's zero (UTM
    and other national grids), it is rounded to meters and kept as ``origin``; ordinary scans keep origin 0.
    Points with NaN or infinity are dropped. Colors become [0, 1] whatever their depth, normals unit length.
    A scan with a pose (E57, PTX) has it applied: its points are in the frame of the file.
    Colors that cannot be used never cost the points: the cloud is read without them, which a note of
    ``read_cloud_report`` says, and so it is where every point has the same color.

    Args:
        path: a file whose name ends in one of ``CLOUD_SUFFIXES``.
        scan: which scan of a file with several: its number, counted from 0, or its name.
        viewpoint: where the scanner stood. "auto" takes the file's own (VIEWPOINT of PCD where it is not
            zero, the key of npz, the comment that ``write_cloud`` leaves in PLY, PCD and text, its element of E57, the
            translation of a pose of E57 or PTX). Where the file says nothing, it assumes the frame's zero, unless the
            points are more than ten times their extent away from it: this guess is marked by ``viewpoint_assumed`` and
            is no evidence for or against a pose. "origin" is the frame's zero, known; ``None`` means that nothing is
            known; three numbers are a known position in the file's frame, in meters.
        dtype: of the result, float32 or float64.
        columns: of a text file, such as "x y z intensity red green blue"; ``None`` takes its header, or what the
            numbers look like, which a note says.
        units: "m", "cm", "mm", "in", "ft" or "us-ft" of the file, or "file" for the unit that it names itself.
            ``None`` keeps its numbers as meters, and a note says where the file names another unit.
        voxel: meters; points are averaged in cubes of this edge while they are read, so that memory is for what is
            kept. ``None`` keeps all points.
        intensity: whether intensity becomes gray colors where there are no colors.

    Returns:
        A batch of one cloud on the CPU; its viewpoint is relative to its origin, and known or assumed as above.

    Raises:
        CloudFileError: the file is missing, of another kind, cut short, contradicts itself, holds
            coordinates that cannot be meant, or several scans of which none is chosen.
        ValueError: an option is none of these.

    Example:
        >>> import tempfile, torchreg.io
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     torchreg.io.write_cloud(f"{folder}/a.ply", Clouds(torch.rand(5, 3)))
        ...     read_cloud(f"{folder}/a.ply").lengths
        [5]
    """
    reading = Reading(viewpoint=viewpoint, dtype=dtype, columns=columns, units=units, voxel=voxel, intensity=intensity)
    return read_cloud_report(path, scan=scan, reading=reading).cloud


@entry
def read_cloud_report(
    path: str | os.PathLike[str],
    *,
    scan: int | str | None = None,
    viewpoint: Viewpoint = "auto",
    dtype: torch.dtype = torch.float32,
    reading: Reading | None = None,
    progress: Progress | None = None,
) -> CloudFile:
    """Read a cloud as ``read_cloud`` does, and report what the file holds; errors are the same.

    Args:
        path: as for ``read_cloud``, and so are ``scan``, ``viewpoint`` and ``dtype``.
        scan: likewise.
        viewpoint: likewise.
        dtype: likewise.
        reading: all options at once, in place of ``viewpoint`` and ``dtype``.
        progress: is called with the rows read so far and the rows of the scan (``None`` where the file does not say).

    Example:
        >>> import torch, torchreg as tr
        >>> tr.write_cloud("a.ply", tr.Clouds(torch.rand(10, 3)))
        >>> tr.io.read_cloud_report("a.ply").viewpoint_source
        'none: not known, as the file says'
    """
    reading = Reading(viewpoint=viewpoint, dtype=dtype) if reading is None else reading
    scan = checked_scan(scan)
    chosen = chosen_scan(Path(path), scans_of(path, reading.columns), scan)
    return finished(Path(path), chosen, reading, progress)


@checked
def each_scan(
    path: str | os.PathLike[str], *, reading: Reading | None = None, progress: Progress | None = None
) -> Iterator[CloudFile]:
    """Read the scans of a file as ``read_scans`` does, one after another: memory is for the one that is looked at.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.write_cloud("a.ply", tr.Clouds(torch.rand(10, 3)))
        >>> [len(file.cloud.points) for file in tr.io.each_scan("a.ply")]
        [10]
    """
    reading = Reading() if reading is None else reading
    scans, notes = with_points(Path(path), scans_of(path, reading.columns))
    for _, one in scans:
        file = finished(Path(path), one, reading, progress)
        yield replace(file, notes=(*file.notes, *notes))


@entry
def read_scans(
    path: str | os.PathLike[str],
    *,
    viewpoint: Viewpoint = "auto",
    dtype: torch.dtype = torch.float32,
    reading: Reading | None = None,
    progress: Progress | None = None,
) -> list[CloudFile]:
    """Read every scan of a file with several, such as E57 or PTX; other files have one.

    Args:
        path: as for ``read_cloud``, and so are ``viewpoint`` and ``dtype``.
        viewpoint: likewise.
        dtype: likewise.
        reading: all options at once, in place of ``viewpoint`` and ``dtype``.
        progress: is called with the rows of a scan read so far and the rows of that scan.

    Returns:
        One record a scan, in the order of the file: its ``cloud``, in the frame of the file and with the scanner's
        position as viewpoint; its ``pose`` (4, 4) ``T_file_scan`` and its name ``scan`` where the file has them.
        Scans without points are left out; a note of the others says which.

    Raises:
        CloudFileError: as for ``read_cloud``, or no scan has points.
        ValueError: an option is invalid.

    Example:
        >>> import tempfile, torchreg.io
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     torchreg.io.write_cloud(f"{folder}/a.ply", Clouds(torch.rand(5, 3)))
        ...     [(len(file.cloud.points), file.pose) for file in read_scans(f"{folder}/a.ply")]
        [(5, None)]
    """
    reading = Reading(viewpoint=viewpoint, dtype=dtype) if reading is None else reading
    return list(each_scan(path, reading=reading, progress=progress))


@entry
def write_cloud(
    path: str | os.PathLike[str], cloud: Clouds, *, T: Tensor | None = None, fields: PointFields | None = None
) -> None:
    """Write one cloud to a file, in full or not at all; its format follows from the suffix.

    Coordinates are written in meters with the origin added. What comes back by ``read_cloud``:

    ===============  ==========================================  =======  ========  ===============================
    Suffix           Coordinates                                 Colors   Normals   Scanner
    ===============  ==========================================  =======  ========  ===============================
    .npz             exact, the origin apart                     exact    kept      kept
    .ply             single precision; double beyond 1 km, with  8 bits   kept      kept, in a comment
                     an origin or for float64 points
    .pcd             single precision (0.03 mm); double beyond   8 bits   kept      kept, in a comment
                     1 km or with an origin
    .e57             double precision                            8 bits   kept      kept; as a pose where it is known
    .xyz .txt .asc   as many digits as it takes                  8 bits   kept      kept, in a comment
    .csv             as many digits as it takes                  8 bits   kept      left out
    .las .laz        steps of 0.1 mm, finer for clouds below     16 bits  left out  left out
                     100 m, coarser above 400 km
    ===============  ==========================================  =======  ========  ===============================

    A scanner that is kept comes back as known or assumed, or not known, as it was; where it is left out, reading
    decides as for any such file. Normals are in single precision but in npz.

    Args:
        path: a name that ends in one of these suffixes.
        cloud: a batch of one.
        T: (4, 4) rigid, ``T_to_from``, origins included; applied in float64 to points, normals and viewpoint
            first. With a result's ``T_target_source[0]`` this writes the source aligned to the target.
        fields: intensities and numbers of scans of the points. PLY, LAS and LAZ keep both, E57 the intensity; other
            formats leave them out.

    Raises:
        ValueError: another suffix, a batch of several clouds, a matrix that is not rigid, no such folder, points
            that are not finite in LAS or LAZ, fields of another number of points.
        CloudFileError: a package that writes the format is not installed.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.write_cloud("a.e57", tr.Clouds(torch.rand(10, 3), colors=torch.rand(10, 3)))
        >>> len(tr.read_cloud("a.e57").points)
        10
    """
    suffix = Path(path).suffix.lower()
    writer = WRITERS.get(suffix)
    if writer is None:
        raise ValueError(f"path: expected a name that ends in {alternatives(WRITERS)}, got {os.fspath(path)!r}")
    expect_in_words(len(cloud) == 1, "cloud", "a batch of one (cloud[b] picks one)", f"{len(cloud)} clouds")
    wide = cloud.to(device="cpu", dtype=torch.float64)
    if T is not None:
        wide = transform(wide, torch.from_numpy(checked_rigid(T, "T")))
    with_fields = None if fields is None else FIELDS_WRITERS.get(suffix)
    with atomic_write(path) as file:
        if with_fields is None:
            writer(file, wide, cloud.points.dtype)
        else:
            with_fields(file, wide, cloud.points.dtype, fields.checked(len(wide.points)) if fields else None)


@entry
def write_scans(path: str | os.PathLike[str], scans: Iterable[PosedScan]) -> None:
    """Write scans to one file of a format that holds many, E57 or PTX, in full or not at all.

    Each scan stays in a frame of its own, and its pose stands beside it. Scans are taken one after another, so that
    memory is for one of them. What a format keeps is in its row (``formats.CAPACITIES``).

    Args:
        path: a name that ends in ``.e57`` or ``.ptx``.
        scans: such as ``posed_scan`` makes them; at least one.

    Raises:
        ValueError: another suffix, no scan, no such folder, points that are not finite in PTX.
        CloudFileError: a package that writes the format is not installed.

    Example:
        >>> import torch, torchreg as tr
        >>> poses = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
        >>> scans = [tr.io.posed_scan(tr.Clouds(torch.rand(10, 3)), T) for T in poses]
        >>> tr.io.write_scans("site.ptx", scans)
        >>> len(tr.read_scans("site.ptx"))
        2
    """
    writer = SCANS_WRITERS.get(Path(path).suffix.lower())
    if writer is None:
        raise ValueError(f"path: expected a name that ends in {alternatives(SCANS_WRITERS)}, got {os.fspath(path)!r}")
    with atomic_write(path) as file:
        writer(file, scans)
