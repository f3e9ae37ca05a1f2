"""Small projects of scans, and runs of the command on them as processes of their own."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

from problems import room_pair

import torchreg as tr


class Project(NamedTuple):
    """A folder of clouds ``c0.ply``, ... and a table of all their pairs."""

    folder: Path
    clouds: int
    table: Path


def make_project(folder: Path, clouds: int, points: int, pairs: int | None = None) -> Project:
    """Clouds of two rooms seen from many places, of unequal sizes; the first so many of their pairs."""
    for number in range(clouds):
        room = room_pair(points + 10 * number, seed=number)
        tr.write_cloud(folder / f"c{number}.ply", room.source if number % 2 else room.target)
    chosen = list(combinations(range(clouds), 2))[:pairs]
    table = write_table(folder / "pairs.csv", [{"source": f"c{i}.ply", "target": f"c{k}.ply"} for i, k in chosen])
    return Project(folder, clouds, table)


def write_table(path: Path, rows: Sequence[dict[str, object]]) -> Path:
    """A pairs file of these rows."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
    return path


def start(*words: object, **environment: str) -> subprocess.Popen[str]:
    """Begin ``torchreg batch`` in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "torchreg", "batch", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"COLUMNS": "200"} | environment,
    )


class Ended(NamedTuple):
    """How a process ended."""

    code: int
    stdout: str
    stderr: str


def finish(process: subprocess.Popen[str]) -> Ended:
    """Wait for a process that ``start`` began."""
    stdout, stderr = process.communicate(timeout=600)
    return Ended(process.returncode, stdout, stderr)


def lines_of(folder: Path) -> list[dict[str, str]]:
    """The table that a batch wrote."""
    with (folder / "results.csv").open(newline="") as file:
        return list(csv.DictReader(file))
