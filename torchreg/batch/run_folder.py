"""The folder of a run on disk: settings, a database, and a lock, so that a run that was cut off can resume."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from filelock import FileLock, Timeout

from torchreg.errors import expect, expect_in_words
from torchreg.io.atomic import remove_remains, write_text

_Folder = TypeVar("_Folder", bound="RunFolder")


class RunFolder:
    """The folder of one run, which one process uses at a time. To be used as a context.

    Args:
        folder: made where it does not exist; the folder above it must.
        manifest: the settings of the run, plain values by name; a run with others is refused.
        database: the name of the file of the database.
        tables: the commands that make its tables where they do not exist.
        folders: names of folders in it, made where they do not exist.
        before: names of what may be in it before the run begins.

    Raises:
        ValueError: the folder belongs to a run of other settings or to something else, or another process is at work
            in it.
        OSError: it cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        manifest: Mapping[str, Any],
        *,
        database: str,
        tables: str,
        folders: Sequence[str] = (),
        before: Sequence[str] = (),
    ) -> None:
        self.folder = folder
        self._file = folder / database
        expect_in_words(folder.absolute().parent.is_dir(), str(folder), "a folder in one that exists", "none there")
        expect_run_folder(folder, before)
        known = folder / "run.json"
        for name in (".lock", "run.json", database, "described", *folders, *before):
            if (folder / name).is_symlink():
                raise ValueError(f"{folder / name}: expected a file or folder of the run itself, got a link")
        folder.mkdir(exist_ok=True)
        self._lock = FileLock(folder / ".lock")
        try:
            self._lock.acquire(timeout=0)
        except Timeout:
            raise ValueError(f"{folder}: expected a folder without a run at work, got one that has one") from None
        try:
            self._begin(known, manifest, tables, folders)
        except BaseException:
            self._lock.release()
            raise

    def _begin(self, known: Path, manifest: Mapping[str, Any], tables: str, folders: Sequence[str]) -> None:
        if known.exists():
            expect_same_run(known, manifest)
        else:
            write_text(known, json.dumps(manifest, indent=2) + "\n", through_link=False)
        inside = [self.folder / name for name in folders]
        for path in inside:
            path.mkdir(exist_ok=True)
        for path in (self.folder, *inside):
            remove_remains(path)
        with self._database_errors():
            self._database = sqlite3.connect(self._file)
            self._database.row_factory = sqlite3.Row
            self._database.text_factory = _text_or_bytes
            with self._database:
                self._database.executescript(tables)

    def __enter__(self: _Folder) -> _Folder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._database.close()
        self._lock.release()

    def rows(self, query: str, values: Sequence[Any] = ()) -> list[sqlite3.Row]:
        """All rows that a query yields."""
        return list(self.each_row(query, values))

    def each_row(self, query: str, values: Sequence[Any] = ()) -> Iterator[sqlite3.Row]:
        """The rows that a query yields, one at a time: together they may be larger than the memory."""
        with self._database_errors(), closing(self._database.execute(query, values)) as rows:
            yield from rows

    def commit(self, command: str, *rows: Sequence[Any]) -> None:
        """Carry out a command for every row of values, all or none, and keep it.

        Raises:
            OSError: it cannot be written; what was committed before is kept.
        """
        with self._database_errors(), self._database:
            self._database.executemany(command, rows)

    @contextmanager
    def _database_errors(self) -> Iterator[None]:
        """Name the file where the database cannot be used: a full disk, a damaged file."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            damaged = type(error) is sqlite3.DatabaseError  # not one of its kinds, such as a full disk
            advice = " (a damaged file: without it, the run begins anew)" if damaged else ""
            raise OSError(f"{self._file}: {error}{advice}") from None


def expect_run_folder(folder: Path, before: Sequence[str] = ()) -> None:
    """Refuse a folder in which no run began, unless it is empty or has nothing but names of ``before``.

    Raises:
        ValueError: it is a file, or holds something else.
    """
    expect_in_words(not folder.exists() or folder.is_dir(), str(folder), "a folder", "a file")
    if folder.is_dir() and not (folder / "run.json").exists():
        # a run that was killed at once may have left a lock or a part of run.json
        names = (path.name for path in folder.iterdir())
        others = sorted(name for name in names if not name.startswith(".") and name not in before)
        if others:
            some = ", ".join(others[:3])
            raise ValueError(f"{folder}: expected an empty folder, or one of a run like this, got one with {some}")


def _text_or_bytes(content: bytes) -> str | bytes:
    """A text of the database, or its bytes where they are no text."""
    try:
        return content.decode()
    except UnicodeDecodeError:
        return content


def differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The values that differ, in words; empty where none do."""
    names = [name for name in {**then, **now} if then.get(name) != now.get(name)]
    return ", ".join(f"{name} {_in_words(then.get(name))} there and {_in_words(now.get(name))} now" for name in names)


def _in_words(value: Any) -> str:  # noqa: ANN401
    return "not given" if value is None else str(value)


def expect_same_run(known: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse a run of other settings than the one that began a folder; the message names what differs."""
    try:
        then = json.loads(known.read_text())
        expect(isinstance(then, dict), str(known), "the options of a run", then)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{known}: expected the options of a run, got another file ({error})") from None
    different = differences(then, manifest)
    if different:
        raise ValueError(
            f"{known.parent}: expected a new folder, or the settings that it was begun with, got {different}"
        )
