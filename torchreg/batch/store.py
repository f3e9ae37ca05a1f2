"""What a batch has done, on disk: every pair as soon as it is finished, so that a run that was cut off can resume.

    DIR/run.json         settings of the run: a run with others is refused
    DIR/batch.sqlite     a row per finished pair, and what is known of the clouds
    DIR/pairs/NAME.json  the whole result of one pair
    DIR/described/       descriptions of clouds, where no other folder is named for them

A pair counts as finished once its row is committed, and its file is written before that.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any

from filelock import FileLock, Timeout

from torchreg.batch.clouds import CloudMeasures, CloudSource
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Row
from torchreg.errors import expect
from torchreg.io.atomic import remove_remains, write_text

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

_FINISHED = "SELECT name, state, said, options, digests, line, seconds FROM pairs"


class FinishedPair:
    """The row of a pair as it was committed."""

    def __init__(self, row: sqlite3.Row) -> None:
        self.state: str = row["state"]  # as in ``Row``
        self.text: str = row["said"]  # the pair as it was written (``Pair.text``)
        self.options: str = row["options"]  # that it was registered with, as one text
        self.digests: tuple[str, str] = tuple(json.loads(row["digests"]))  # of both clouds
        self.line: dict[str, Any] = json.loads(row["line"])  # of the table
        self.seconds: dict[str, float] = json.loads(row["seconds"])  # by stage


class Store:
    """The folder of one batch, which one process uses at a time. To be used as a context.

    Args:
        folder: made where it does not exist; the folder above it must.
        manifest: the settings of the run, plain values by name.

    Raises:
        ValueError: the folder belongs to a run of other settings or to something else, or another process is at work
            in it.
        OSError: it cannot be written.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, Any]) -> None:
        self.folder = folder
        expect(folder.absolute().parent.is_dir(), str(folder), "a folder in one that exists", "none there")
        expect(not folder.exists() or folder.is_dir(), str(folder), "a folder", "a file")
        known = folder / "run.json"
        if folder.is_dir() and not known.exists():
            # a run that was killed at once may have left a lock or a part of run.json
            others = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
            if others:
                some = ", ".join(others[:3])
                raise ValueError(f"{folder}: expected an empty folder, or one of a batch, got one with {some}")
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
            write_text(known, json.dumps(manifest, indent=2) + "\n")
        (self.folder / "pairs").mkdir(exist_ok=True)
        for folder in (self.folder, self.folder / "pairs"):
            remove_remains(folder)
        with self._database_errors():
            self._database = sqlite3.connect(self.folder / "batch.sqlite")
            self._database.row_factory = sqlite3.Row
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
        return {row["name"]: FinishedPair(row) for row in self._rows(_FINISHED)}

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
        rows = self._rows("SELECT name, record FROM pairs")
        records = {row["name"]: row["record"] for row in rows}
        for pair in pairs:
            if pair.name in records:
                self._write_record(pair, records[pair.name])

    def _write_record(self, pair: Pair, record: str | None) -> None:
        """Write or remove a pair's file, where it is not as it should be."""
        path = self.folder / "pairs" / f"{pair.file_name}.json"
        if record is None:
            path.unlink(missing_ok=True)  # of an earlier run, when the clouds were others
        elif not path.is_file() or path.read_bytes() != record.encode():
            write_text(path, record)

    def measures(self) -> dict[tuple[CloudSource, float | None], tuple[str, CloudMeasures]]:
        """The measures of clouds, each behind the stamp that its file had then."""
        return {
            (CloudSource(*json.loads(row["source"])), json.loads(row["asked"])): (
                row["stamp"],
                CloudMeasures(*json.loads(row["look"])),
            )
            for row in self._rows("SELECT * FROM clouds")
        }

    def keep_measures(self, source: CloudSource, voxel: float | None, stamp: str, measures: CloudMeasures) -> None:
        """Keep the measures of a cloud in place of earlier ones."""
        values = (json.dumps(source), json.dumps(voxel), stamp, json.dumps(measures))
        self._commit("INSERT OR REPLACE INTO clouds VALUES (?, ?, ?, ?)", values)

    def add_work(self, stage: str, seconds: float) -> None:
        """Count seconds of work that belongs to no single pair."""
        command = (
            "INSERT INTO work VALUES (?, ?) ON CONFLICT (stage) DO UPDATE SET seconds = seconds + excluded.seconds"
        )
        self._commit(command, (stage, seconds))

    def work(self) -> dict[str, float]:
        """Seconds of work that belongs to no single pair, by stage."""
        rows = self._rows("SELECT stage, seconds FROM work ORDER BY rowid")
        return {row["stage"]: row["seconds"] for row in rows}

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
            raise OSError(f"{self.folder / 'batch.sqlite'}: {error}") from None


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
    except ValueError as error:
        raise ValueError(f"{known}: expected the options of a run, got another file ({error})") from None
    different = differences(then, manifest)
    if different:
        raise ValueError(
            f"{known.parent}: expected a new folder, or the settings that it was begun with, got {different}"
        )
