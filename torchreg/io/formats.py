"""The kinds of files that hold clouds, one row each; readers, writers, messages and help texts follow from the rows.

To add a kind, write its reader, its writer or both in a file of its own and name them in a row of ``FORMATS``. Import a
package that not everybody has inside these functions, so that it loads with the first such file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import torch

from torchreg.io.assemble import RawCloud
from torchreg.io.capacity import USUAL, Capacity
from torchreg.io.e57 import read_e57
from torchreg.io.e57_writer import write_e57, write_e57_scans
from torchreg.io.fields import PointFields
from torchreg.io.las import read_las
from torchreg.io.las_writer import BRIGHTEST, TOP, las_step, write_las, write_laz
from torchreg.io.npz import read_npz, write_npz
from torchreg.io.pcd import read_pcd
from torchreg.io.pcd_writer import pcd_step, write_pcd
from torchreg.io.ply import read_ply, write_ply
from torchreg.io.posed import PosedScan
from torchreg.io.ptx import read_ptx
from torchreg.io.ptx_writer import write_ptx_scans
from torchreg.io.stream import ScanStream
from torchreg.io.text import read_named_text, read_text
from torchreg.io.text_writer import write_csv, write_xyz
from torchreg.io.unread import unread_e57, unread_las, unread_ply, unread_ptx
from torchreg.types import Clouds

Scan = RawCloud | ScanStream
"""A scan of a file: its points, or what reads them by chunks."""

Reader = Callable[[Path], Iterator[Scan]]
"""Yields the scans of a file one after another: one in most formats, many in a project of a scanner."""

ColumnReader = Callable[[Path, str], Iterator[Scan]]
"""A reader that is told what the columns are, such as "x y z red green blue"."""

Writer = Callable[[BinaryIO, Clouds, torch.dtype], None]
"""Writes one cloud, which is on the CPU in float64, to an open file; the dtype is the one that the caller has it in."""

FieldsWriter = Callable[[BinaryIO, Clouds, torch.dtype, PointFields | None], None]
"""A writer that also takes fields of the points, on the CPU; it writes those that the row says are kept."""

ScansWriter = Callable[[BinaryIO, Iterable[PosedScan]], None]
"""Writes any number of scans, each in a frame of its own with its pose, to an open file."""


@dataclass(frozen=True, kw_only=True)
class CloudFormat:
    """One kind of file.

    Attributes:
        suffixes: what the names of such files end in, in lower case, the usual one first.
        words: what the format is, as help texts put it behind the suffixes.
        read: ``None`` where the format is only written.
        write: ``None`` where no single cloud is written.
        write_fields: where the format keeps fields beside a cloud.
        write_scans: where a file may hold many scans, each with its pose.
        read_columns: where the format does not always say what its columns are.
        keeps: what a file that is written keeps of a cloud.
        unread: what a file that is read holds besides, a few words each; ``None`` for formats that hold no more.
    """

    suffixes: tuple[str, ...]
    words: str
    read: Reader | None = None
    write: Writer | None = None
    write_fields: FieldsWriter | None = None
    write_scans: ScansWriter | None = None
    read_columns: ColumnReader | None = None
    keeps: Capacity = USUAL
    unread: Callable[[Path], tuple[str, ...]] | None = None


_LAS = Capacity(
    brightest=BRIGHTEST, normals=False, scanner=False, step=las_step, fields=("intensity", "scan"), intensity=TOP
)

FORMATS = (
    CloudFormat(
        suffixes=(".ply",),
        words="PLY, as text or binary",
        read=read_ply,
        write=write_ply,
        write_fields=write_ply,
        keeps=Capacity(fields=("intensity", "scan")),
        unread=unread_ply,
    ),
    CloudFormat(
        suffixes=(".pcd",),
        words="PCD, as text, binary or compressed",
        read=read_pcd,
        write=write_pcd,
        keeps=Capacity(step=pcd_step),
    ),
    CloudFormat(
        suffixes=(".e57",),
        words="E57, of one scan or many, by pye57",
        read=read_e57,
        write=write_e57,
        write_fields=write_e57,
        write_scans=write_e57_scans,
        keeps=Capacity(fields=("intensity",)),
        unread=unread_e57,
    ),
    CloudFormat(
        suffixes=(".las",),
        words="LAS, by laspy",
        read=read_las,
        write=write_las,
        write_fields=write_las,
        keeps=_LAS,
        unread=unread_las,
    ),
    CloudFormat(
        suffixes=(".laz",),
        words="LAZ and COPC, by laspy",
        read=read_las,
        write=write_laz,
        write_fields=write_laz,
        keeps=_LAS,
        unread=unread_las,
    ),
    CloudFormat(
        suffixes=(".ptx",),
        words="PTX, of one scan or many",
        read=read_ptx,
        write_scans=write_ptx_scans,
        keeps=Capacity(normals=False, claims_scanner=True, fields=("intensity",), intensity=1.0),
        unread=unread_ptx,
    ),
    CloudFormat(
        suffixes=(".xyz", ".txt", ".asc"),
        words="text, one point a line",
        read=read_text,
        read_columns=read_named_text,
        write=write_xyz,
    ),
    CloudFormat(
        suffixes=(".csv",),
        words="text with commas",
        read=read_text,
        read_columns=read_named_text,
        write=write_csv,
        keeps=Capacity(scanner=False),
    ),
    CloudFormat(suffixes=(".pts",), words="text after a count of points", read=read_text, read_columns=read_named_text),
    CloudFormat(
        suffixes=(".npz",),
        words="NumPy arrays, nothing rounded",
        read=read_npz,
        write=write_npz,
        keeps=Capacity(brightest=None),
    ),
)

READERS = {suffix: row.read for row in FORMATS if row.read is not None for suffix in row.suffixes}
WRITERS = {suffix: row.write for row in FORMATS if row.write is not None for suffix in row.suffixes}
FIELDS_WRITERS = {
    suffix: row.write_fields for row in FORMATS if row.write_fields is not None for suffix in row.suffixes
}
SCANS_WRITERS = {suffix: row.write_scans for row in FORMATS if row.write_scans is not None for suffix in row.suffixes}
CAPACITIES = {suffix: row.keeps for row in FORMATS if row.write or row.write_scans for suffix in row.suffixes}
UNREAD = {suffix: row.unread for row in FORMATS if row.unread is not None for suffix in row.suffixes}

COLUMN_READERS = {
    suffix: row.read_columns for row in FORMATS if row.read_columns is not None for suffix in row.suffixes
}

CLOUD_SUFFIXES = tuple(READERS)
"""What the names of clouds that can be read end in."""


AMBIGUOUS_SUFFIXES = (".txt", ".csv")
"""Suffixes of clouds and of other files too: a pattern means clouds where it ends so itself."""


def alternatives(suffixes: Iterable[str]) -> str:
    """Suffixes in words, such as ".ply, .pcd or .npz"."""
    *others, last = suffixes
    return f"{', '.join(others)} or {last}" if others else last


def formats_in_words() -> str:
    """All formats that can be read, such as ".ply (PLY, as text or binary), .pcd (...)"."""
    return ", ".join(f"{alternatives(row.suffixes)} ({row.words})" for row in FORMATS if row.read is not None)
