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
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, TypeVar

from torchreg.arguments import checked
from torchreg.batch.clouds import CloudMeasures, CloudSource
from torchreg.batch.finished import FinishedPair, known_cloud, seconds_of_work
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import Row
from torchreg.batch.run_folder import RunFolder
from torchreg.io.atomic import write_text

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


class Store(RunFolder):
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

    Example:
        >>> from pathlib import Path
        >>> from torchreg.batch import Store
        >>> with Store(Path("results_of_store"), {"seed": 0}) as store:
        ...     len(store.finished())
        0
    """

    @checked
    def __init__(self, folder: Path, manifest: Mapping[str, Any]) -> None:
        super().__init__(folder, manifest, database=_DATABASE, tables=_TABLES, folders=("pairs",))
        self.damaged: list[str] = []

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
        self.commit(_FINISH, (row.name, row.state, pair.text, options, *texts, record, now))

    def mend_records(self, pairs: Sequence[Pair]) -> None:
        """Write the files of finished pairs again that are missing or have been changed."""
        finished = self.finished()
        of_name = {pair.name: pair for pair in pairs if pair.name in finished}
        for row in self.each_row(_RECORDS):
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
        self.commit("INSERT OR REPLACE INTO clouds VALUES (?, ?, ?, ?)", values)

    def add_work(self, stage: str, seconds: float) -> None:
        """Count seconds of work that belongs to no single pair."""
        self.commit(_ADD_WORK, (stage, seconds))

    def work(self) -> dict[str, float]:
        """Seconds of work that belongs to no single pair, by stage."""
        return dict(self._parsed("work", "stage", _WORK, seconds_of_work))

    def _parsed(self, table: str, key: str, query: str, parse: Callable[[sqlite3.Row], _Parsed]) -> list[_Parsed]:
        """The rows of a table as they are to be; one that holds something else is noted and left out."""
        found = []
        for row in self.rows(query):
            try:
                found.append(parse(row))
            except ValueError as error:
                note = f"{self.folder / _DATABASE}, table {table}, {key} {row[key]!r}: {error}"
                if note not in self.damaged:
                    self.damaged.append(note)
        return found
