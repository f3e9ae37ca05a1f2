"""A list of pairs to register: a table with one pair a line, or JSON."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import expect
from torchreg.io.checks import excerpt, readable_file, refuse, require
from torchreg.io.csv_cells import text_of_cell
from torchreg.io.pairs_json import cells_of_list
from torchreg.io.transform_text import checked_rigid, read_transform_text

_NEEDED = ("source", "target")
_KNOWN = (*_NEEDED, "truth", "name")
_DELIMITERS = (",", ";", "\t")
_LARGEST_FILE = 1 << 26  # bytes; beyond it somebody named a cloud where a table was meant


@checked_record
@dataclass(frozen=True, eq=False, kw_only=True)
class PairRow:
    """One pair of a pairs file.

    Attributes:
        line: where it stands in the file, counted from 1: its line of a table, its place in a list.
        where: the same in words with the file's name, for messages.
        name: different for every pair of the file.
        source: the file of the source cloud.
        target: the file of the target cloud.
        source_text: the same as the table has it.
        target_text: the same as the table has it.
        T_target_source: (4, 4) float64, meters, the true motion ``x_target = R @ x_source + t``, or ``None``
            where the table does not say.
        extra: cells of other columns by the column's name in lower case; empty cells are left out.

    Example:
        >>> import torchreg as tr
        >>> from pathlib import Path
        >>> _ = Path("pairs.csv").write_text("source,target\\na.ply,b.ply\\n")
        >>> row = tr.io.read_pairs_file("pairs.csv")[0]
        >>> row.line, row.source_text
        (2, 'a.ply')
    """

    line: int
    where: str
    name: str
    source: Path
    target: Path
    source_text: str
    target_text: str
    T_target_source: Tensor | None
    extra: dict[str, str]


@entry
def read_pairs_file(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> tuple[PairRow, ...]:
    """Read the pairs that a table or a list lists; whether their clouds exist is not checked.

    The table has the columns ``source`` and ``target`` (files of clouds) and, where wanted, ``truth`` and
    ``name``; other columns are kept as they are. A truth is sixteen numbers, row after row, with anything of
    spaces, commas, semicolons and square brackets between them, or else the name of a file that
    ``read_transform_text`` reads.

    Cells are separated by commas, semicolons or tabs: by the first of the three under which the header, the first
    line that counts, has both needed columns. Blank lines and lines that start with ``#`` do not count. Text is
    UTF-8, with or without its byte order mark; lines end in any of the three usual ways; cells may be quoted with
    ``"`` and then hold separators and, below the header, line ends. An apostrophe before what a spreadsheet would take
    for a formula does not belong to the cell, as in the tables that are written here (``cell_of_text``).

    A file that ends in ``.json`` is a list: an object with, under ``pairs``, objects that have ``source``, ``target``
    and, where wanted, ``name`` and ``T``, the true motion as four rows of four numbers; further texts and numbers are
    kept as a table's other columns are.

    A pair without a name is called by its files, ``SOURCE__TARGET`` without folders and suffixes. Where that
    is taken, ``__2``, ``__3``, ... comes behind it: the first number that is free.

    Args:
        path: the table or the list.
        root: the folder that relative file names start from; ``None`` takes the folder of the file.

    Returns:
        The pairs in the order of the file, at least one.

    Raises:
        CloudFileError: the file cannot be read, lacks a column or has one twice, has a row of too few or too many
            cells or a quote that is not closed, lists nothing, leaves out a source or target, holds the same pair
            twice, or names a truth that cannot be read or is not a rigid transform. The message names the file and
            the line, or the place in the list.
        ValueError: ``root`` is not a folder.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = Path(folder, "pairs.csv").write_text("source,target\\na.ply,b.ply\\n")
        ...     [row.name for row in read_pairs_file(f"{folder}/pairs.csv")]
        ['a__b']
    """
    file = Path(path)
    if root is not None:
        expect(Path(root).is_dir(), "root", "a folder that exists", os.fspath(root))
    base = file.parent if root is None else Path(root)
    is_list = file.suffix.lower() == ".json"
    table = _read_list(file) if is_list else _read_table(file)
    require(bool(table), file, "at least one pair" if is_list else "at least one pair below the header", "none")
    places: dict[tuple[str, str], str] = {}
    names: set[str] = set()
    pairs = []
    for row in table:
        where = f"{file}, {row.place}"
        pair = _pair(row, base, names, where)
        key = (os.path.normpath(pair.source), os.path.normpath(pair.target))
        before = places.setdefault(key, row.place)
        again = f"{pair.source_text}, {pair.target_text} as in {before}"
        require(before == row.place, where, "a pair not listed before", again)
        pairs.append(pair)
    return tuple(pairs)


class _TableRow(NamedTuple):
    line: int  # where the row begins, counted from 1 over all lines of the file
    place: str  # the same in words
    cells: dict[str, str]  # by the name of the column, without the white space around them


def _pair(row: _TableRow, base: Path, names: set[str], where: str) -> PairRow:
    """The pair of a row; its name is added to those taken."""
    cells = row.cells
    for column in _NEEDED:
        require(cells[column] != "", where, f"a file in the column {column}", "an empty cell")
    source, target = (base / cells[column] for column in _NEEDED)
    return PairRow(
        line=row.line,
        where=where,
        name=_name(cells.get("name", ""), f"{source.stem}__{target.stem}", names, where),
        source=source,
        target=target,
        source_text=cells["source"],
        target_text=cells["target"],
        T_target_source=_truth(cells.get("truth", ""), base, where),
        extra={name: cell for name, cell in cells.items() if name not in _KNOWN and cell != ""},
    )


def _name(given: str, otherwise: str, taken: set[str], where: str) -> str:
    """The name given, which must be free, or else the first free one that begins with another text."""
    require(given not in taken, where, "a name that no pair before it has", excerpt(given))
    name, count = given or otherwise, 1
    while name in taken:
        count += 1
        name = f"{otherwise}__{count}"
    taken.add(name)
    return name


def _truth(cell: str, base: Path, where: str) -> Tensor | None:
    """The transform in a cell, or in the file that the cell names; ``None`` for an empty cell."""
    if cell == "":
        return None
    try:
        numbers = [float(word) for word in cell.translate(dict.fromkeys(map(ord, "[],;"), " ")).split()]
    except ValueError:
        numbers = []
    is_file = len(numbers) < 2  # one number alone may be the name of a file
    require(is_file or len(numbers) == 16, where, "a truth of sixteen numbers", f"{len(numbers)}: {excerpt(cell)}")
    try:
        if is_file:
            return read_transform_text(base / cell)
        return torch.from_numpy(checked_rigid([numbers[i : i + 4] for i in range(0, 16, 4)], "truth"))
    except ValueError as error:
        refuse(where, "a truth that is a rigid transform", str(error))


def _read_list(path: Path) -> list[_TableRow]:
    """The entries of a list as rows of a table."""
    file = readable_file(path)
    entries = cells_of_list(_plain_text(file), file)
    return [_TableRow(number, f"pair {number}", cells) for number, cells in enumerate(entries, start=1)]


def _read_table(path: Path) -> list[_TableRow]:
    """The rows of a table, the names of its columns in lower case; none where there is only a header."""
    file = readable_file(path)
    lines = enumerate(_lines(file), start=1)
    number, header = next(((n, line) for n, line in lines if _counts(line)), (0, ""))
    require(number > 0, file, "a header line", "nothing but blank lines and comments")
    mark, names = _columns(header, f"{file}, line {number}")
    rows = []
    for number, line in lines:
        if not _counts(line):
            continue
        where = f"{file}, line {number}"
        # The reader takes further lines only where a quoted cell continues in them.
        reader = csv.reader(chain([line], (more for _, more in lines)), delimiter=mark, strict=True)
        try:
            cells = next(reader)
        except csv.Error as error:
            refuse(where, "cells without quotes or within a pair of them", f"{excerpt(line.strip())} ({error})")
        require(len(cells) == len(names), where, f"{len(names)} cells, as the header has", f"{len(cells)}")
        texts = (text_of_cell(cell.strip()) for cell in cells)
        rows.append(_TableRow(number, f"line {number}", dict(zip(names, texts, strict=True))))
    return rows


def _lines(file: Path) -> list[str]:
    """The lines with their ends, all of them a line feed."""
    return [f"{line}\n" for line in _plain_text(file).split("\n")]


def _plain_text(file: Path) -> str:
    """The text of a file, all its line ends a line feed."""
    require(file.stat().st_size <= _LARGEST_FILE, file, "a list of pairs", "a file above 64 MB")
    raw = file.read_bytes()
    zero = raw.find(b"\0")
    if zero >= 0:
        refuse(f"{file}, line {raw.count(10, 0, zero) + 1}", "text in UTF-8", "a NUL byte")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = f"the byte 0x{raw[error.start]:02x}"
        refuse(f"{file}, line {raw.count(10, 0, error.start) + 1}", "text in UTF-8", byte)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _counts(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _columns(header: str, where: str) -> tuple[str, list[str]]:
    """The separator and the names of the columns."""
    names: dict[str, list[str]] = {}
    broken = ""
    for mark in _DELIMITERS:
        try:
            cells = next(csv.reader([header], delimiter=mark, strict=True))
        except csv.Error as error:
            broken, cells = str(error), []  # quotes may fit another separator
        names[mark] = [text_of_cell(cell.strip().lower()) for cell in cells]
        if set(_NEEDED) <= set(names[mark]):
            break
    else:
        if not any(names.values()):
            refuse(where, "a header on one line, in cells without quotes or within a pair of them", broken)
        most = max(names.values(), key=len)
        refuse(where, f"the columns {' and '.join(_NEEDED)}", ", ".join(most))
    columns = names[mark]
    for column, name in enumerate(columns, start=1):
        require(name != "", where, "a name for every column", f"none for column {column}")
        require(columns.count(name) == 1, where, "every column once", f"{excerpt(name)} {columns.count(name)} times")
    return mark, columns
