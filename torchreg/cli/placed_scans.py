"""The scans of a site written back with their new poses: into which files, what of them, and what is lost."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import NamedTuple

import torch

from torchreg.cli.guard import complain
from torchreg.cli.output import Output
from torchreg.cli.progress import step
from torchreg.cli.wording import by_options
from torchreg.errors import CloudFileError, expect, expect_in_words
from torchreg.io import CloudFile, PointFields, PosedScan, Reading, each_scan, posed_scan, write_cloud, write_scans
from torchreg.io.formats import CAPACITIES, SCANS_WRITERS, UNREAD, alternatives
from torchreg.io.written import narrowest
from torchreg.report.text import counted
from torchreg.site.result import SiteResult

PLACED_SUFFIXES = tuple(CAPACITIES)
"""Formats in which placed scans can be written."""

LARGEST_WRITTEN = 20_000_000
"""Points of a scan that are written as they are; more would not fit into the memory of a small computer."""


class InputScan(NamedTuple):
    """One scan of a site: the file it is in."""

    path: Path
    argument: int
    """The place of the file among those given: a file may be given twice."""


class PlacedFile(NamedTuple):
    """A file to write, and the numbers of the scans that go into it."""

    path: Path
    scans: tuple[int, ...]


def check_placed(placed: Path | None, suffix: str | None, inputs: Sequence[Path]) -> tuple[Output, ...]:
    """Check before the work begins that placed scans can be written, and over none of the inputs.

    Returns:
        The file, where all scans go into one, for ``check_outputs``.

    Raises:
        ValueError: no such folder, one that holds an input, a format that is not known or that an input needs.
    """
    if placed is None:
        expect(suffix is None, "--placed-format", "--placed too", suffix)
        return ()
    if is_project(placed):
        expect(suffix is None, "--placed-format", f"none beside the file {placed}", suffix)
        return (Output("--placed", placed),)
    fits = placed.absolute().parent.is_dir() and (not placed.exists() or placed.is_dir())
    where = f"a folder in one that exists, or the name of a {alternatives(SCANS_WRITERS)} file"
    expect(fits, "--placed", where, os.fspath(placed))
    known = suffix is None or suffix in PLACED_SUFFIXES
    expect(known, "--placed-format", alternatives(PLACED_SUFFIXES), suffix)
    for path in inputs:
        inside = os.path.realpath(path).startswith(os.path.join(os.path.realpath(placed), ""))
        expect_in_words(not inside, "--placed", "a folder without scans that are read", f"{placed}, which holds {path}")
        fits = suffix is not None or path.suffix.lower() in PLACED_SUFFIXES
        needed = f"{alternatives(PLACED_SUFFIXES)}, since {path.name} cannot be written as what it is"
        expect(fits, "--placed-format", needed, suffix)
    return ()


def is_project(placed: Path) -> bool:
    """Whether all scans go into one file, as its name says."""
    return placed.suffix.lower() in SCANS_WRITERS and not placed.is_dir()


def placed_files(
    placed: Path, suffix: str | None, scans: Sequence[InputScan], site: SiteResult, others: Sequence[Path] = ()
) -> list[PlacedFile]:
    """Which scans go into which files.

    A format that holds many scans gets one file for each that was read, others one for each scan, below the folder that
    all inputs share. Groups beside the largest, whose frames are others, have folders of their own. No two files have
    names that differ only in case, and none has a name of ``others``.
    """
    if is_project(placed):
        return [PlacedFile(placed, tuple((site.group == 0).nonzero()[:, 0].tolist()))]
    names = _names_of_arguments(scans)
    size, seen = Counter(scan.argument for scan in scans), Counter[int]()
    parts: dict[tuple[int, str], list[int]] = {}  # a group, and the name of a file in its folder
    for number, (scan, group) in enumerate(zip(scans, site.group.tolist(), strict=True)):
        ending = suffix or scan.path.suffix.lower()
        alone = size[scan.argument] == 1 or ending in SCANS_WRITERS
        name = names[scan.argument] + ("" if alone else f"_{seen[scan.argument]:02d}") + ending
        seen[scan.argument] += 1
        if group >= 0:
            parts.setdefault((group, name), []).append(number)
    taken = {os.path.realpath(path).lower() for path in others}
    files = []
    for (group, name), numbers in parts.items():
        path = _free((placed if group == 0 else placed / f"group{group}") / name, taken)
        files.append(PlacedFile(path, tuple(numbers)))
    return files


def _names_of_arguments(scans: Sequence[InputScan]) -> dict[int, str]:
    """A name for each file that was read, without a suffix, below the folder that all share."""
    paths = {scan.argument: scan.path for scan in scans}
    folder = os.path.commonpath([path.absolute().parent for path in paths.values()])
    stems = {
        argument: os.path.join(os.path.relpath(path.absolute().parent, folder), path.stem.removesuffix(".copc"))
        for argument, path in paths.items()
    }
    often, used = Counter(stem.lower() for stem in stems.values()), Counter[str]()
    names = {}
    for argument, stem in stems.items():
        name = f"{stem}_{paths[argument].suffix[1:]}" if often[stem.lower()] > 1 else stem
        used[name.lower()] += 1
        names[argument] = name if used[name.lower()] == 1 else f"{name}-{used[name.lower()]}"
    return names


def _free(path: Path, taken: set[str]) -> Path:
    """The path, or one with a number in its name where it is taken; it is then."""
    tries = (path.with_name(f"{path.stem}{f'-{number}' if number > 1 else ''}{path.suffix}") for number in count(1))
    free = next(one for one in tries if os.path.realpath(one).lower() not in taken)
    taken.add(os.path.realpath(free).lower())
    return free


def write_placed(
    placed: Path,
    suffix: str | None,
    scans: Sequence[InputScan],
    site: SiteResult,
    reading: Reading,
    others: Sequence[Path] = (),
) -> list[Path]:
    """Write every placed scan with its new pose, read anew at its full resolution; say what is lost.

    One scan after another is read, so that memory is for one. Files named ``others`` are left alone.

    Returns:
        The files.

    Raises:
        CloudFileError: a file changed while the scans were registered.
    """
    losses: Counter[str] = Counter()
    written = []
    files = placed_files(placed, suffix, scans, site, [*others, *(scan.path for scan in scans)])
    left = len(site) - sum(len(file.scans) for file in files)
    full = replace(reading, dtype=torch.float64, at_most=None if reading.voxel is not None else LARGEST_WRITTEN)
    for path, numbers in files:
        path.parent.mkdir(parents=True, exist_ok=True)
        with step(f"writing {path.name}"):
            _write(path, _read(scans, numbers, full), site, scans, losses)
        written.append(path)
    for loss, times in losses.items():
        complain(f"{placed}: {by_options(loss)} ({counted(times, 'scan')})")
    if left:
        other = " or lie in another frame than the largest group" if is_project(placed) else ""
        complain(f"{placed}: {counted(left, 'scan')} not written: they are not placed{other}")
    return written


def _write(
    path: Path,
    files: Iterator[tuple[int, CloudFile]],
    site: SiteResult,
    scans: Sequence[InputScan],
    losses: Counter[str],
) -> None:
    suffix = path.suffix.lower()

    def noted() -> Iterator[tuple[int, CloudFile, PointFields]]:
        for number, file in files:
            fields = PointFields(intensity=None if file.color_depth == "intensity" else file.intensity)
            kept = (*CAPACITIES[suffix].losses(file.cloud, fields), *_left_behind(scans[number].path))
            losses.update([*kept, *([f"thinned to cubes of {file.voxel:.3g} m"] if file.voxel else [])])
            yield number, file, fields

    if suffix in SCANS_WRITERS:
        write_scans(path, (_posed(*one, site, scans) for one in noted()))
        return
    for number, file, fields in noted():
        write_cloud(path, narrowest(file.cloud), T=site.T_world_scan[number], fields=fields)


def _posed(
    number: int, file: CloudFile, fields: PointFields, site: SiteResult, scans: Sequence[InputScan]
) -> PosedScan:
    name = file.scan or Path(scans[number].path).stem
    return posed_scan(file.cloud, site.T_world_scan[number], pose=file.pose, name=name, fields=fields)


def _left_behind(path: Path) -> tuple[str, ...]:
    unread = UNREAD.get(path.suffix.lower())
    return () if unread is None else unread(path)


def _read(scans: Sequence[InputScan], numbers: Sequence[int], reading: Reading) -> Iterator[tuple[int, CloudFile]]:
    """These scans, one after another."""
    for argument in dict.fromkeys(scans[number].argument for number in numbers):
        together = [number for number, scan in enumerate(scans) if scan.argument == argument]
        path, wanted = scans[together[0]].path, set(numbers) & set(together)
        files = each_scan(path, reading=reading)
        for number in together[: together.index(max(wanted)) + 1]:
            file = next(files, None)
            if file is None:
                raise CloudFileError(f"{path}: expected {len(together)} scans, as there were before, got fewer")
            if number in wanted:
                yield number, file
