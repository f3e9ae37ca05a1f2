"""What is known of a site on disk, so that a run that was cut off goes on where it was.

    DIR/run.json       settings of the run: a run with others is refused
    DIR/site.sqlite    the looks at the scans of every file, and what every pair found
    DIR/described/     descriptions of scans
    DIR/shards/K-of-N  the same, of a run that registers a share of the pairs

A text that is damaged counts as missing, so that the work is done again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from torchreg.batch.run_folder import RunFolder, expect_same_run
from torchreg.batch.survey import stamp_of
from torchreg.io.result_json import plain_data
from torchreg.site.files import FileItem, SeenScan

_TABLES = """
CREATE TABLE IF NOT EXISTS files (name TEXT PRIMARY KEY, content TEXT NOT NULL, checksum TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS pairs (name TEXT PRIMARY KEY, content TEXT NOT NULL, checksum TEXT NOT NULL);
"""
_KEPT = tuple(f"SELECT * FROM {table}" for table in ("files", "pairs"))

OF_SHARDS = ("described", "shards")
"""What shards make in the folder of a site before the run that places the scans begins there."""


class SiteStore(RunFolder):
    """The folder of a site, which one process uses at a time. To be used as a context.

    Args:
        folder: made where it does not exist; the folder above it must.
        manifest: the settings of the run that its results depend on, plain values by name.

    Raises:
        ValueError: the folder or a shard in it belongs to a run of other settings or to something else, or another
            process is at work in it.
        OSError: it cannot be written.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, Any]) -> None:
        for shard in shard_folders(folder):  # before a run of settings that do not fit them begins the folder
            expect_same_run(shard / "run.json", manifest)
        super().__init__(folder, manifest, database="site.sqlite", tables=_TABLES, before=OF_SHARDS)
        self._manifest = manifest
        self._files, self._pairs = (dict(_sound(self.rows(query))) for query in _KEPT)

    def adopt(self, folder: Path) -> int:
        """Take over what the store of a shard has; returns how many pairs are new.

        Raises:
            ValueError: it belongs to a run of other settings, or another process is at work in it.
        """
        before = len(self._pairs)
        with SiteStore(folder, self._manifest) as other:
            for table, known, found in (("files", self._files, other._files), ("pairs", self._pairs, other._pairs)):
                self._keep(table, known, {name: text for name, text in found.items() if name not in known})
        return len(self._pairs) - before

    def seen(self, item: FileItem) -> list[SeenScan] | None:
        """The scans of a file that did not change since they were looked at; ``None`` where it must be read."""
        content = self._files.get(_name(item))
        return None if content is None else [SeenScan(*row) for row in json.loads(content)]

    def keep_seen(self, item: FileItem, scans: Iterable[SeenScan]) -> None:
        """Keep the looks at the scans of a file."""
        self._keep("files", self._files, {_name(item): json.dumps(list(scans))})

    def pairs(self, names: Iterable[str]) -> dict[str, str]:
        """What the pairs of these names found, of those that were registered."""
        return {name: self._pairs[name] for name in names if name in self._pairs}

    def keep_pairs(self, texts: Mapping[str, str]) -> None:
        """Keep what pairs found, by name.

        Raises:
            OSError: it cannot be written; what was kept before stays.
        """
        self._keep("pairs", self._pairs, texts)

    def _keep(self, table: str, known: dict[str, str], texts: Mapping[str, str]) -> None:
        rows = [(name, text, _checksum(name, text)) for name, text in texts.items()]
        self.commit(f"INSERT OR REPLACE INTO {table} VALUES (?, ?, ?)", *rows)
        known.update(texts)


def shard_folders(folder: Path) -> list[Path]:
    """The folders of the shards that began in the folder of a site."""
    return sorted(known.parent for known in folder.glob("shards/*/run.json"))


def _sound(rows: Iterable[Any]) -> Iterable[tuple[str, str]]:
    """Names and contents of rows as they were written."""
    for name, content, checksum in rows:
        if isinstance(name, str) and isinstance(content, str) and _checksum(name, content) == checksum:
            yield name, content


def _checksum(name: str, content: str) -> str:
    return hashlib.blake2b(f"{name}\0{content}".encode(), digest_size=16).hexdigest()


def _name(item: FileItem) -> str:
    """A file as it is and how it is read."""
    how = plain_data({key: value for key, value in vars(item.reading).items() if key not in ("thinning", "dtype")})
    return json.dumps([item.path, stamp_of(item.path), how, item.scaled], sort_keys=True)
