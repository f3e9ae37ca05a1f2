"""How records show themselves: a few lines of text, and a table in notebooks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from html import escape
from typing import Any

from torch import Tensor

from torchreg.types.held import Listed, Offsets, PerItem, held_by

_MOST_ROWS = 20  # of a table
_MOST_NUMBERS = 3  # of an entry of a table: a place, not a matrix
_MOST_NAMED = 4  # numbers of a line

_UNREADABLE = (AttributeError, RuntimeError, TypeError, ValueError)
"""What reading numbers raises that are not there."""


def text_of(record: Any, facts: Callable[[], Sequence[str]]) -> str:  # noqa: ANN401
    """The class and its facts, line by line; the shapes alone where there are no numbers to read.

    Such as on the meta device, while a graph is captured, and where a pytree was made of other leaves than tensors.
    """
    name = type(record).__name__
    try:
        lines = facts()
    except _UNREADABLE:
        lines = ["; ".join(kinds_of(record))]
    return f"{name}(" + f",\n{' ' * (len(name) + 1)}".join(lines) + ")"


def html_of(record: Any, facts: Callable[[], Sequence[str]]) -> str:  # noqa: ANN401
    """The class and its facts above a table with a row per item, of what is a number, a place or a text."""
    lines = text_of(record, facts).split("\n")
    head = f"<strong>{escape(lines[0])}</strong>" + "".join(f"<br>{escape(line.strip())}" for line in lines[1:])
    try:
        columns = dict(_columns(record)) if hasattr(record, "noun") else {}
    except _UNREADABLE:
        columns = {}
    if not columns or len(record) == 0:
        return f"<div>{head}</div>"
    heads = "".join(f"<th>{escape(name)}</th>" for name in ("", *columns))
    rows = "".join(
        f"<tr><th>{number}</th>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"
        for number, cells in enumerate(zip(*columns.values(), strict=True))
        if number < _MOST_ROWS
    )
    more = f"<div>and {len(record) - _MOST_ROWS} more {record.noun}</div>" if len(record) > _MOST_ROWS else ""
    table = f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"
    return f"<div>{head}</div>{table}{more}"


def kinds_of(record: Any) -> Iterator[str]:  # noqa: ANN401
    """The shapes of the tensors of a record, and where they are, without a look at numbers."""
    for name in held_by(type(record)):
        value = getattr(record, name, None)
        if isinstance(value, Tensor):
            yield f"{name} {tuple(value.shape)} on {value.device}"
        elif value is not None and value != ():
            yield f"{name} {type(value).__name__}"


def several(count: int, noun: str) -> str:
    """So many things; ``noun`` in the plural."""
    return f"{count} {noun[:-1] if count == 1 else noun}"


def listed(values: Sequence[object]) -> str:
    """The first few values in words, and how many there are if there are more."""
    named = ", ".join(map(_number, values[:_MOST_NAMED]))
    return named if len(values) <= _MOST_NAMED else f"{named} ... ({len(values)} in all)"


def counted(values: Sequence[int]) -> str:
    """Numbers of points or the like in words: of one, of a few, or from the least to the most."""
    if len(values) > _MOST_NAMED:
        return f"{min(values):,} to {max(values):,}"
    return " + ".join(f"{value:,}" for value in values) or "no"


def where(tensor: Tensor) -> str:
    """Dtype and device of a tensor in words."""
    return f"{str(tensor.dtype).removeprefix('torch.')} on {tensor.device}"


def _columns(batch: Any) -> Iterator[tuple[str, list[str]]]:  # noqa: ANN401
    """Of every field that has them, the entries of all items in words."""
    for name, kind in held_by(type(batch)).items():
        value = getattr(batch, name)
        if isinstance(kind, Offsets):
            yield name.replace("offsets", "rows").strip("_"), [f"{count:,}" for count in value.diff().tolist()]
        elif isinstance(kind, PerItem) and isinstance(value, Tensor) and value[:1].numel() <= _MOST_NUMBERS:
            yield name, [_number(entry) for entry in value.detach().tolist()]
        elif isinstance(kind, PerItem) and hasattr(value, "lengths"):
            yield f"{name} points", [f"{count:,}" for count in value.lengths]
        elif isinstance(kind, Listed) and kind.shown:
            yield name, ["" if thing is None else str(thing) for thing in value]


def _number(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_number, value))
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.4g}"
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
