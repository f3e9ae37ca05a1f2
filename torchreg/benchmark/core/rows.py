"""Measurements kept line by line as they come, so that an unfinished run is resumed where it stopped."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from torchreg.errors import CloudFileError, expect_in_words

Row = dict[str, Any]
"""One measurement: plain JSON."""

FILE = "rows.jsonl"


class Rows:
    """The measurements in a folder: a first line with what they depend on, then one per line.

    Args:
        folder: where ``rows.jsonl`` lies or will lie.
        manifest: what all rows depend on. A folder of other rows is refused.

    Raises:
        ValueError: the folder holds measurements with another manifest; the message names the difference.
        CloudFileError: ``rows.jsonl`` is something else.
    """

    def __init__(self, folder: Path, manifest: dict[str, Any]) -> None:
        self.path = folder / FILE
        self._rows: dict[str, Row] = {}
        if not self.path.exists() or self.path.stat().st_size == 0:
            self._write(manifest)
            return
        kept = self._read()
        if not kept:
            os.truncate(self.path, 0)
            self._write(manifest)
            return
        before = kept[0]
        for name in sorted(before.keys() | manifest.keys()):
            old, new = before.get(name), manifest.get(name)
            expect_in_words(
                old == new, "--out", f"a folder without measurements, or with {name} {new!r}", f"one with {old!r}"
            )
        self._rows = {row["key"]: row for row in kept[1:]}

    def __contains__(self, key: str) -> bool:
        return key in self._rows

    def __getitem__(self, key: str) -> Row:
        return self._rows[key]

    def add(self, row: Row) -> None:
        """Keep a row under its ``key``; it is on the disk when this returns."""
        self._write(row)
        self._rows[row["key"]] = row

    def _write(self, content: dict[str, Any]) -> None:
        with self.path.open("a") as file:
            file.write(json.dumps(content, allow_nan=False) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def _read(self) -> list[dict[str, Any]]:
        """All whole lines; the torn last line of a killed process is cut off."""
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        try:
            lines = [json.loads(line) for line in whole.splitlines()]
            fits = all(isinstance(row, dict) for row in lines) and all("key" in row for row in lines[1:])
        except ValueError:
            fits = False
        if not fits:
            raise CloudFileError(f"{self.path}: expected measurements, one a line, got something else")
        if len(whole) < len(content):
            os.truncate(self.path, len(whole))
        return lines
