"""Results written one by one, so that a run that breaks off goes on where it stopped."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any


class Records:
    """Measurements under keys, appended to a file of JSON lines as they come.

    Args:
        path: the file, made when the first record comes; what it holds already is kept. ``None`` keeps all in memory.

    A last line that broke off is left out, and written over by the next record.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._found: dict[str, Any] = {}
        if path is not None and path.exists():
            whole = path.read_text()
            lines = whole[: whole.rfind("\n") + 1].splitlines()
            if len(whole) > whole.rfind("\n") + 1:
                path.write_text("".join(line + "\n" for line in lines))
            for line in lines:
                entry = json.loads(line)
                self._found[entry["key"]] = entry["value"]

    def get(self, key: str, measure: Callable[[], Any]) -> Any:  # noqa: ANN401
        """The record of this key, measured and written if there is none."""
        if key not in self._found:
            value = measure()
            if self._path is not None:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                with self._path.open("a") as file:
                    file.write(json.dumps({"key": key, "value": value}) + "\n")
            self._found[key] = value
        return self._found[key]
