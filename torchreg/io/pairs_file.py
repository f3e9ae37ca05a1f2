"""A list of pairs to register, as a table: one pair a line."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from torchreg.errors import expect
from torchreg.io.checks import excerpt, refuse, require
from torchreg.io.delimited import TableRow, read_delimited
from torchreg.io.transform_text import checked_rigid, read_transform_text

_KNOWN = ("source", "target", "truth", "name")


@dataclass(frozen=True, eq=False, kw_only=True)
class PairRow:
    """One pair of a pairs file.

    Attributes:
        line: where it stands in the file, counted from 1.
        name: different for every pair of the file.
        source: the file of the source cloud.
        target: the file of the target cloud.
        source_text: the same as the table has it.
        target_text: the same as the table has it.
        T_target_source: (4, 4) float64, meters, the true motion ``x_target = R @ x_source + t``, or ``None``
            where the table does not say.
        extra: cells of other columns by the column's name in lower case; empty cells are left out.
    """

    line: int
    name: str
    source: Path
    target: Path
    source_text: str
    target_text: str
    T_target_source: Tensor | None
    extra: dict[str, str]


def read_pairs_file(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> tuple[PairRow, ...]:
    """Read the pairs that a table lists; whether their clouds exist is not looked at.

    The table has the columns ``source`` and ``target`` (files of clouds) and, where wanted, ``truth`` and
    ``name``; other columns are kept as they are. See ``read_delimited`` for what the file may look like. A
    truth is sixteen numbers, row after row, with anything of spaces, commas, semicolons and square brackets
    between them, or else the name of a file that ``read_transform_text`` reads.

    A pair without a name is called by its files, ``SOURCE__TARGET`` without folders and suffixes. Where that
    is taken, ``__2``, ``__3``, ... comes behind it: the first number that is free.

    Args:
        path: the table.
        root: the folder that relative file names start from; ``None`` takes the folder of the table.

    Returns:
        The pairs in the order of the table, at least one.

    Raises:
        CloudFileError: the table cannot be read, lists nothing, leaves out a source or target, holds the same
            pair twice, or names a truth that cannot be read or is not a rigid transform. The message names
            the file and the line.
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
    table = read_delimited(file, ("source", "target"))
    require(bool(table), file, "at least one pair below the header", "none")
    lines: dict[tuple[str, str], int] = {}
    names: set[str] = set()
    pairs = []
    for row in table:
        where = f"{file}, line {row.line}"
        pair = _pair(row, base, names, where)
        key = (os.path.normpath(pair.source), os.path.normpath(pair.target))
        before = lines.setdefault(key, row.line)
        again = f"{pair.source_text}, {pair.target_text} as in line {before}"
        require(before == row.line, where, "a pair not listed before", again)
        pairs.append(pair)
    return tuple(pairs)


def _pair(row: TableRow, base: Path, names: set[str], where: str) -> PairRow:
    """The pair of a row; its name is added to those taken."""
    cells = row.cells
    for column in ("source", "target"):
        require(cells[column] != "", where, f"a file in the column {column}", "an empty cell")
    source, target = (base / cells[column] for column in ("source", "target"))
    return PairRow(
        line=row.line,
        name=_name(cells.get("name", ""), f"{source.stem}__{target.stem}", names, where),
        source=source,
        target=target,
        source_text=cells["source"],
        target_text=cells["target"],
        T_target_source=_truth(cells.get("truth", ""), base, where),
        extra={name: cell for name, cell in cells.items() if name not in _KNOWN and cell != ""},
    )


def _name(given: str, otherwise: str, taken: set[str], where: str) -> str:
    """The name given, which must be free, or one that is made."""
    if given:
        require(given not in taken, where, "a name that no pair before it has", excerpt(given))
        taken.add(given)
        return given
    return _free_name(otherwise, taken)


def _free_name(wanted: str, taken: set[str]) -> str:
    name, count = wanted, 1
    while name in taken:
        count += 1
        name = f"{wanted}__{count}"
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
