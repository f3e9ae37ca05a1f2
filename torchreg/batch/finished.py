"""The rows of a batch's database as they are read again: what one has to hold, and an error that says what it does not.

A database that was edited by hand, or damaged beneath SQLite, may hold anything in any cell.
"""

from __future__ import annotations

import json
import sqlite3
from typing import Any, get_type_hints

from torchreg.batch.clouds import CloudMeasures, CloudSource
from torchreg.batch.rows import BROKEN, COLUMNS, REFUSED, REGISTERED, UNREADABLE
from torchreg.errors import expect, expect_in_words, one_of

_KINDS: dict[str, tuple[type, ...]] = {
    "text": (str,),
    "bool": (bool,),
    "number": (float, int),
    "count": (int,),
    "numbers": (list,),
}
"""What JSON gives for what a column of the table holds."""

_FILLED = ("name", "source", "target", "success", "state")


class FinishedPair:
    """The row of a pair as it was committed.

    Raises:
        ValueError: a cell that holds something else; the message names it.
    """

    def __init__(self, row: sqlite3.Row) -> None:
        self.state = one_of(row["state"], "state", (REGISTERED, REFUSED, UNREADABLE, BROKEN))  # as in ``Row``
        self.text = _text(row, "said")  # the pair as it was written (``Pair.text``)
        self.options = _text(row, "options")  # that it was registered with, as one text
        self.digests = _digests(row)  # of both clouds
        self.line: dict[str, Any] = _object(row, "line")  # of the table
        self.seconds: dict[str, float] = _object(row, "seconds")  # by stage
        _object(row, "said")
        for name, kind in COLUMNS.items():
            if name not in self.line:
                raise ValueError(f"line: expected the column {name}, got {', '.join(self.line) or 'none'}")
            _expect_kind(self.line[name], "line, column", name, kind, filled=name in _FILLED)
        for name in self.line.keys() - COLUMNS.keys():
            _expect_kind(self.line[name], "line, column", name, "text", filled=False)
        expect(self.line["name"] == row["name"], "line", f"the name {row['name']!r}", self.line["name"])
        expect(self.line["state"] == self.state, "line", f"the state {self.state}", self.line["state"])
        for stage, seconds in self.seconds.items():
            _expect_kind(seconds, "seconds of", stage, "number", filled=True)
        if self.state in (REGISTERED, REFUSED):
            expect(
                row["name_recorded"] == row["name"], "record", "JSON with the name of the pair", row["name_recorded"]
            )
        else:
            expect_in_words(not row["recorded"], "record", "none of a pair without a result", "one")


def known_cloud(row: sqlite3.Row) -> tuple[CloudSource, float | None, str, CloudMeasures]:
    """A cloud, the voxel edge that was asked for, the stamp that its file had, and its measures.

    Raises:
        ValueError: a cell that holds something else; the message names it.
    """
    source, asked, look = (_json(row, name) for name in ("source", "asked", "look"))
    expect(asked is None or _is(asked, (float, int)), "asked", "a number or null", asked)
    return (
        CloudSource(*_fields(source, "source", CloudSource)),
        asked,
        _text(row, "stamp"),
        CloudMeasures(*_fields(look, "look", CloudMeasures)),
    )


def seconds_of_work(row: sqlite3.Row) -> tuple[str, float]:
    """A stage and the seconds that it took.

    Raises:
        ValueError: a cell that holds something else; the message names it.
    """
    _expect_kind(row["seconds"], "the column", "seconds", "number", filled=True)
    return _text(row, "stage"), row["seconds"]


def _text(row: sqlite3.Row, name: str) -> str:
    expect(isinstance(row[name], str), name, "a text in UTF-8", row[name])
    text: str = row[name]
    return text


def _json(row: sqlite3.Row, name: str) -> Any:  # noqa: ANN401
    text = _text(row, name)
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError(f"{name}: expected JSON, got {text[:40]!r}") from None


def _object(row: sqlite3.Row, name: str) -> dict[str, Any]:
    content = _json(row, name)
    expect(isinstance(content, dict), name, "an object", content)
    found: dict[str, Any] = content
    return found


def _digests(row: sqlite3.Row) -> tuple[str, str]:
    content = _json(row, "digests")
    two = isinstance(content, list) and len(content) == 2 and all(isinstance(one, str) for one in content)
    expect(two, "digests", "a list of two texts", content)
    source, target = content
    return source, target


def _fields(content: Any, name: str, kind: type) -> list[Any]:  # noqa: ANN401
    """A list of values for the fields of a named tuple, each of the type that its field has."""
    hints = get_type_hints(kind)
    fits = isinstance(content, list) and len(content) == len(hints)
    expect(fits, name, f"a list of {', '.join(hints)}", content)
    for (field, hint), value in zip(hints.items(), content, strict=True):
        expect(_is(value, _types(hint)), f"{name}, {field}", str(getattr(hint, "__name__", hint)), value)
    found: list[Any] = content
    return found


def _types(hint: Any) -> tuple[type, ...]:  # noqa: ANN401
    """The types of values that a hint such as ``float | None`` admits; a whole number is a ``float`` too."""
    kinds = getattr(hint, "__args__", (hint,))
    return (*kinds, int) if float in kinds else kinds


def _expect_kind(value: Any, where: str, name: str, kind: str, *, filled: bool) -> None:  # noqa: ANN401
    fits = not filled if value is None else _is(value, _KINDS[kind])
    if fits and isinstance(value, list):
        fits = all(_is(one, (float, int)) for one in value)
    if not fits:  # a message for each of the many that fit would take most of the time
        expect(False, f"{where} {name}", f"a {kind}" if filled else f"a {kind} or null", value)


def _is(value: Any, kinds: tuple[type, ...]) -> bool:  # noqa: ANN401
    """Whether a value has one of the types; true and false are no numbers."""
    return isinstance(value, kinds) and (bool in kinds or not isinstance(value, bool))
