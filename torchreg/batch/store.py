"""What a batch has done, on disk: every pair as soon as it is finished, so that a run that was cut off can resume.

    DIR/run.json         settings of the run: a run with others is refused
    DIR/batch.sqlite     a row per finished pair, and what is known of the clouds
    DIR/pairs/NAME.json  the whole result of one pair
    DIR/described/       descriptions of clouds, where no other folder is named for them

A pair counts as finished once its row is committed, and its file is written before that. A row that does not hold what
was committed is as good as none: its pair is registered again.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from filelock import FileLock, Timeout

from torchreg.batch.clouds import CloudMeasures, CloudSource
from torchreg.batch.finished import FinishedPair, known_cloud, seconds_of_work
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Row
from torchreg.errors import expect
from torchreg.io.atomic import remove_remains, write_text

_Parsed = TypeVar("_Parsed")

_TABLES = """
CREATE TABLE IF NOT EXISTS pairs (
    name TEXT PRIMARY KEY, state TEXT NOT NULL, said TEXT NOT NULL, options TEXT NOT NULL, digests TEXT NOT NULL,
    line TEXT NOT NULL, seconds TEXT NOT NULL, record TEXT, finished TEXT NOT NULL, runs INTEGER NOT NULL
);
CREATE TABLE IF NOT EXISTS clouds (
    source TEXT NOT NULL, asked TEXT NOT NULL, stamp TEXT NOT NULL, look TEXT NOT NULL,
    PRIMARY KEY (source, asked)
);
CREATE TABLE IF NOT EXISTS work (stage TEXT PRIMARY KEY, seconds REAL NOT NULL);
"""

_FINISH = """
INSERT INTO pairs VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, 1) ON CONFLICT (name) DO UPDATE SET
    state = excluded.state, said = excluded.said, options = excluded.options, digests = excluded.digests,
    line = excluded.line, seconds = excluded.seconds, record = excluded.record,
    finished = excluded.finished, runs = runs + 1
"""

_FINISHED = """
SELECT name, state, said, options, digests, line, seconds, record IS NOT NULL AS recorded,
    CASE WHEN json_valid(record) THEN json_extract(record, '$.name') END AS name_recorded
FROM pairs
"""
_RECORDS = "SELECT name, record FROM pairs"
_CLOUDS = "SELECT source, asked, stamp, look FROM clouds"
_WORK = "SELECT stage, seconds FROM work ORDER BY rowid"
_ADD_WORK = """
INSERT INTO work VALUES (?, ?) ON CONFLICT (stage) DO UPDATE SET seconds = ifnull(seconds, 0) + excluded.seconds
"""

_DATABASE = "batch.sqlite"
_OWN = (".lock", "run.json", _DATABASE, "pairs", "described")  # names in the folder that no link may stand for


class Store:
    """The folder of one batch, which one process uses at a time. To be used as a context.

    Args:
        folder: made where it does not exist; the folder above it must.
        manifest: the settings of the run, plain values by name.

    Attributes:
        damaged: what rows were found to hold that they should not, each once; they were left out.

    Raises:
        ValueError: the folder belongs to a run of other settings or to something else, another process is at work in
            it, or a link stands where it has a file or folder of its own.
        OSError: it cannot be written.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, Any]) -> None:
        self.folder = folder
        self.damaged: list[str] = []
        expect(folder.absolute().parent.is_dir(), str(folder), "a folder in one that exists", "none there")
        expect(not folder.exists() or folder.is_dir(), str(folder), "a folder", "a file")
        known = folder / "run.json"
        if folder.is_dir() and not known.exists():
            # a run that was killed at once may have left a lock or a part of run.json
            others = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
            if others:
                some = ", ".join(others[:3])
                raise ValueError(f"{folder}: expected an empty folder, or one of a batch, got one with {some}")
        for name in _OWN:
            own = folder / name
            if own.is_symlink():
                raise ValueError(f"{own}: expected a file or folder of the batch itself, got a link")
        folder.mkdir(exist_ok=True)
        self._lock = FileLock(folder / ".lock")
        try:
            self._lock.acquire(timeout=0)
        except Timeout:
            raise ValueError(f"{folder}: expected a folder without a run at work, got one that has one") from None
        try:
            self._begin(known, manifest)
        except BaseException:
            self._lock.release()
            raise

    def _begin(self, known: Path, manifest: Mapping[str, Any]) -> None:
        if known.exists():
            _expect_same_run(known, manifest)
        else:
            write_text(known, json.dumps(manifest, indent=2) + "\n", through_link=False)
        (self.folder / "pairs").mkdir(exist_ok=True)
        for folder in (self.folder, self.folder / "pairs"):
            remove_remains(folder)
        with self._database_errors():
            self._database = sqlite3.connect(self.folder / _DATABASE)
            self._database.row_factory = sqlite3.Row
            self._database.text_factory = _text_or_bytes
            with self._database:
                self._database.executescript(_TABLES)

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._database.close()
        self._lock.release()

    def finished(self) -> dict[str, FinishedPair]:
        """The pairs that have a row, by name."""
        rows = self._parsed("pairs", "name", _FINISHED, lambda row: (row["name"], FinishedPair(row)))
        return dict(rows)

    def finish(self, pair: Pair, row: Row, options: str) -> None:
        """Write the file of a pair and commit its row.

        Raises:
            OSError: it cannot be written; rows committed before are kept.
        """
        record = None if row.record is None else json.dumps(row.record, indent=2, allow_nan=False) + "\n"
        self._write_record(pair, record)
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        texts = map(json.dumps, (row.digests, row.table, row.seconds))
        self._commit(_FINISH, (row.name, row.state, pair.text, options, *texts, record, now))

    def mend_records(self, pairs: Sequence[Pair]) -> None:
        """Write the files of finished pairs again that are missing or have been changed."""
        finished = self.finished()
        of_name = {pair.name: pair for pair in pairs if pair.name in finished}
        with self._database_errors(), closing(self._database.execute(_RECORDS)) as rows:
            for row in rows:  # one at a time: together they may be larger than the memory
                if row["name"] in of_name:
                    self._write_record(of_name[row["name"]], row["record"])

    def _write_record(self, pair: Pair, record: str | None) -> None:
        """Write or remove a pair's file, where it is not as it should be."""
        path = self.folder / "pairs" / f"{pair.file_name}.json"
        if record is None:
            path.unlink(missing_ok=True)  # of an earlier run, when the clouds were others
        elif path.is_symlink() or not path.is_file() or path.read_bytes() != record.encode():
            write_text(path, record, through_link=False)

    def measures(self) -> dict[tuple[CloudSource, float | None], tuple[str, CloudMeasures]]:
        """The measures of clouds, each behind the stamp that its file had then."""
        rows = self._parsed("clouds", "source", _CLOUDS, known_cloud)
        return {(source, voxel): (stamp, measures) for source, voxel, stamp, measures in rows}

    def keep_measures(self, source: CloudSource, voxel: float | None, stamp: str, measures: CloudMeasures) -> None:
        """Keep the measures of a cloud in place of earlier ones."""
        values = (json.dumps(source), json.dumps(voxel), stamp, json.dumps(measures))
        self._commit("INSERT OR REPLACE INTO clouds VALUES (?, ?, ?, ?)", values)

    def add_work(self, stage: str, seconds: float) -> None:
        """Count seconds of work that belongs to no single pair."""
        self._commit(_ADD_WORK, (stage, seconds))

    def work(self) -> dict[str, float]:
        """Seconds of work that belongs to no single pair, by stage."""
        return dict(self._parsed("work", "stage", _WORK, seconds_of_work))

    def _parsed(self, table: str, key: str, query: str, parse: Callable[[sqlite3.Row], _Parsed]) -> list[_Parsed]:
        """The rows of a table as they are to be; one that holds something else is noted and left out."""
        found = []
        for row in self._rows(query):
            try:
                found.append(parse(row))
            except ValueError as error:
                note = f"{self.folder / _DATABASE}, table {table}, {key} {row[key]!r}: {error}"
                if note not in self.damaged:
                    self.damaged.append(note)
        return found

    def _rows(self, query: str) -> list[sqlite3.Row]:
        with self._database_errors(), closing(self._database.execute(query)) as rows:
            return list(rows)

    def _commit(self, command: str, values: tuple[Any, ...]) -> None:
        with self._database_errors(), self._database:
            self._database.execute(command, values)

    @contextmanager
    def _database_errors(self) -> Iterator[None]:
        """Name the file where the database cannot be used: a full disk, a damaged file."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            raise OSError(f"{self.folder / _DATABASE}: {error}") from None


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


def _expect_same_run(known: Path, manifest: Mapping[str, Any]) -> None:
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
