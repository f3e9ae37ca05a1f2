"""The poses of a site as a table: one row a scan."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape
from torchreg.geometry.rigid_check import expect_rigid
from torchreg.io.atomic import write_text
from torchreg.io.checks import require
from torchreg.io.csv_cells import cell_of_text
from torchreg.io.scan_table import ScanRow, read_scan_table, scan_number

COLUMNS = ("scan", "group", *(f"m{row}{column}" for row in range(4) for column in range(4)))
"""Of the table: the pose is T_world_scan, row by row."""


def write_poses_csv(path: str | os.PathLike[str], scans: Sequence[str], group: Tensor, T_world_scan: Tensor) -> None:
    """Write the poses of scans as CSV, in full or not at all.

    Numbers have as many digits as float64 needs. Where a scan is not placed, its group and pose are empty. A name that
    a spreadsheet would take for a formula gets an apostrophe before it (``cell_of_text``).

    Args:
        path: the file.
        scans: the name of each of N scans.
        group: (N,) int64, -1 where not placed.
        T_world_scan: (N, 4, 4) float64, meters, from the frame of each scan's file to that of its group.

    Raises:
        ValueError: numbers of scans that differ, or no such folder.
    """
    expect_shape(group, "group", (len(scans),))
    expect(T_world_scan.shape == (len(scans), 4, 4), "T_world_scan", f"({len(scans)}, 4, 4)", T_world_scan)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for name, number, pose in zip(scans, group.tolist(), T_world_scan.flatten(1).tolist(), strict=True):
        cells = [number, *map(repr, pose)] if number >= 0 else [""] * (len(COLUMNS) - 1)
        writer.writerow([cell_of_text(name), *cells])
    write_text(path, text.getvalue(), through_link=False)


class ScanPose(NamedTuple):
    """The pose of one scan as a table has it."""

    scan: int
    T_world_scan: Tensor  # (4, 4) float64, meters


def read_poses_csv(path: str | os.PathLike[str], names: Sequence[str]) -> list[ScanPose]:
    """Read the poses of scans from a table such as ``write_poses_csv`` writes.

    Needed are the columns scan and m00 to m33; rows without a pose are passed over.

    Args:
        path: the table.
        names: of the scans. A row means one of them by its name, that of its file or its number.

    Raises:
        CloudFileError: a table that cannot be read, a scan that is not among these or comes twice, or a matrix that is
            no rigid transform; the message names file and line.
    """
    poses: dict[int, Tensor] = {}
    for row, T in _pose_rows(path):
        text = row.cells["scan"]
        scan = scan_number(text[1:] if text.startswith("'") else text, names, row.where)
        require(scan not in poses, row.where, "one pose of a scan", f"another of {names[scan]}")
        poses[scan] = T
    return [ScanPose(scan, T) for scan, T in poses.items()]


def check_poses_csv(path: str | os.PathLike[str]) -> None:
    """Check a table of poses as far as that is possible before the scans are known.

    Raises:
        CloudFileError: as for ``read_poses_csv``, but for the names of scans.
    """
    _pose_rows(path)


def _pose_rows(path: str | os.PathLike[str]) -> list[tuple[ScanRow, Tensor]]:
    """The rows of a table that have a pose, and the poses (4, 4)."""
    numbers, rows = COLUMNS[2:], []
    for row in read_scan_table(path, ("scan", *numbers)):
        if any(row.cells[column] != "" for column in numbers):
            T = torch.tensor(row.numbers(numbers), dtype=torch.float64).view(4, 4)
            expect_rigid(T, row.where)
            rows.append((row, T))
    require(bool(rows), path, "at least one pose", "none")
    return rows
