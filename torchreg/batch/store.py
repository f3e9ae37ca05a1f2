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
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from torchreg.batch.clouds import CloudMeasures, CloudSource
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Row
from torchreg.batch.run_folder import RunFolder
from torchreg.io.atomic import write_text

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


class Store(RunFolder):
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
        super().__init__(folder, manifest, database="batch.sqlite", tables=_TABLES, folders=("pairs",))

    def finished(self) -> dict[str, FinishedPair]:
        """The pairs that have a row, by name."""
        return {row["name"]: FinishedPair(row) for row in self.rows(_FINISHED)}

    def finish(self, pair: Pair, row: Row, options: str) -> None:
        """Write the file of a pair and commit its row.

        Raises:
            OSError: it cannot be written; rows committed before are kept.
        """
        record = None if row.record is None else json.dumps(row.record, indent=2, allow_nan=False) + "\n"
        self._write_record(pair, record)
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        texts = map(json.dumps, (row.digests, row.table, row.seconds))
        self.commit(_FINISH, (row.name, row.state, pair.text, options, *texts, record, now))

    def mend_records(self, pairs: Sequence[Pair]) -> None:
        """Write the files of finished pairs again that are missing or have been changed."""
        rows = self.rows("SELECT name, record FROM pairs")
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
            for row in self.rows("SELECT * FROM clouds")
        }

    def keep_measures(self, source: CloudSource, voxel: float | None, stamp: str, measures: CloudMeasures) -> None:
        """Keep the measures of a cloud in place of earlier ones."""
        values = (json.dumps(source), json.dumps(voxel), stamp, json.dumps(measures))
        self.commit("INSERT OR REPLACE INTO clouds VALUES (?, ?, ?, ?)", values)

    def add_work(self, stage: str, seconds: float) -> None:
        """Count seconds of work that belongs to no single pair."""
        command = (
            "INSERT INTO work VALUES (?, ?) ON CONFLICT (stage) DO UPDATE SET seconds = seconds + excluded.seconds"
        )
        self.commit(command, (stage, seconds))

    def work(self) -> dict[str, float]:
        """Seconds of work that belongs to no single pair, by stage."""
        rows = self.rows("SELECT stage, seconds FROM work ORDER BY rowid")
        return {row["stage"]: row["seconds"] for row in rows}
