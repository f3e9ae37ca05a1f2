"""True motions between fragments, as Redwood and 3DMatch write them, ``gt.log`` and ``gt.info``; trajectories.

A ``.log`` file repeats a header ``i j n`` (two fragments, and how many there are) and four lines of a 4 x 4
matrix. The matrix takes points of fragment j into the frame of fragment i: Open3D's benchmark of such folders
registers i onto j and writes the inverse of what it finds. An ``.info`` file has six lines of a 6 x 6 matrix
instead: the information of that motion, by which the benchmark weighs errors. A trajectory has the same form with a
header ``i i i+1`` over the pose of each frame i in the world.

Choi, Zhou and Koltun, Robust Reconstruction of Indoor Scenes, CVPR 2015, doi:10.1109/CVPR.2015.7299195;
http://redwood-data.org/indoor/fileformat.html.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.io.atomic import write_text
from torchreg.io.checks import count_of, excerpt, readable_file, refuse, require
from torchreg.io.transform_text import checked_rigid

_LARGEST_FILE = 1 << 26  # bytes


@dataclass(frozen=True, eq=False, kw_only=True)
class LogEntry:
    """The true motion between two fragments."""

    line: int  # where its header stands in the file, counted from 1
    i: int  # number of the fragment whose frame the matrix leads to, from 0
    j: int  # number of the fragment whose points it moves
    T_i_j: Tensor  # (4, 4) float64, meters: ``x_i = R @ x_j + t``


def read_redwood_log(path: str | os.PathLike[str]) -> tuple[LogEntry, ...]:
    """Read the motions of a ``gt.log``, in the order of the file.

    Raises:
        CloudFileError: the file is missing, empty, cut short or something else, a matrix is not rigid within
            1e-4, or a pair comes twice. The message names the line.
    """
    entries = []
    for line, i, j, rows in _blocks(Path(path), 4):
        try:
            matrix = checked_rigid(rows, "the matrix")
        except ValueError as error:
            refuse(f"{os.fspath(path)}, line {line}", "a rigid transform", str(error))
        entries.append(LogEntry(line=line, i=i, j=j, T_i_j=torch.from_numpy(matrix)))
    return tuple(entries)


def read_redwood_info(path: str | os.PathLike[str]) -> dict[tuple[int, int], Tensor]:
    """Read the information matrices (6, 6) float64 of a ``gt.info``, by their pair (i, j).

    Raises:
        CloudFileError: as ``read_redwood_log``; the matrices must be finite.
    """
    matrices = {}
    for line, i, j, rows in _blocks(Path(path), 6):
        matrix = torch.tensor(rows, dtype=torch.float64)
        where = f"{os.fspath(path)}, line {line}"
        require(bool(matrix.isfinite().all()), where, "finite numbers", "others among those below")
        matrices[i, j] = matrix
    return matrices


def write_redwood_trajectory(path: str | os.PathLike[str], numbers: Sequence[int], T_world_scan: Tensor) -> None:
    """Write poses as a trajectory, as Redwood's and Open3D's programs read it; in full or not at all.

    Args:
        path: the file.
        numbers: of N scans, which the headers name.
        T_world_scan: (N, 4, 4) rigid, meters: x_world = R x_scan + t.

    Raises:
        ValueError: another number of poses, or no such folder.
    """
    expect(T_world_scan.shape == (len(numbers), 4, 4), "T_world_scan", f"({len(numbers)}, 4, 4)", T_world_scan)
    blocks = [
        f"{number} {number} {number + 1}\n" + "".join(f"{' '.join(map(repr, row))}\n" for row in pose)
        for number, pose in zip(numbers, T_world_scan.double().tolist(), strict=True)
    ]
    write_text(path, "".join(blocks))


def _blocks(path: Path, size: int) -> Iterator[tuple[int, int, int, list[list[float]]]]:
    """Line, i, j and the ``size`` rows of ``size`` numbers of every block; blank lines do not count."""
    file = readable_file(path)
    require(file.stat().st_size <= _LARGEST_FILE, file, f"matrices of {size} x {size} numbers", "a file above 64 MB")
    text = file.read_bytes().decode("utf-8", errors="replace").split("\n")
    lines = [(n, words) for n, line in enumerate(text, start=1) if (words := line.split())]
    require(bool(lines), file, "a header i j n", "nothing but blank lines")
    before: dict[tuple[int, int], int] = {}
    for first in range(0, len(lines), size + 1):
        line, header = lines[first]
        where = f"{file}, line {line}"
        i, j = _pair(header, where)
        known = before.setdefault((i, j), line)
        require(known == line, where, "a pair not listed before", f"{i} {j} as in line {known}")
        body = lines[first + 1 : first + 1 + size]
        require(len(body) == size, where, f"{size} lines of numbers below it", f"{len(body)} before the file ends")
        yield line, i, j, [_numbers(words, size, f"{file}, line {n}") for n, words in body]


def _pair(header: list[str], where: str) -> tuple[int, int]:
    require(len(header) == 3, where, "a header i j n", excerpt(" ".join(header)))
    i, j, count = (count_of(word, Path(where), "each of i j n") for word in header)
    require(i != j, where, "two different fragments i j n", f"{i} {j} {count}, as a trajectory of one camera has")
    require(max(i, j) < count, where, f"fragments below the number n = {count} of them", f"{i} {j}")
    return i, j


def _numbers(words: list[str], size: int, where: str) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    require(len(numbers) == size, where, f"{size} numbers", excerpt(" ".join(words)))
    return numbers
