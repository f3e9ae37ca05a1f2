"""Options in meters: fields marked as lengths, so that all lengths of a record change together.

A record marks its lengths where it declares them (``radius: float = length()``); scaling options, and comparing them
without their lengths, follow from that mark.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, field, fields, is_dataclass, replace
from typing import Any, TypeVar, cast

Options = TypeVar("Options")

_MARK = {"unit": "m"}


def length(default: Any = MISSING) -> Any:  # noqa: ANN401
    """A field of a frozen options record that is a length in meters, or ``None`` where its default is ``None``."""
    return field(default=default, metadata=_MARK)


def scaled(options: Options, factor: float) -> Options:
    """Multiply every length of a record by ``factor``, those of records inside it too; ``None`` stays ``None``."""

    def inside(record: Options) -> Options:
        return cast(Options, record.scaled(factor)) if hasattr(record, "scaled") else scaled(record, factor)

    return _with_lengths(options, lambda value, _: None if value is None else factor * value, inside)


def without_lengths(options: Options) -> Options:
    """The record with every length at one meter (``None`` where that is its default).

    Two records become equal exactly where they differ in lengths alone.
    """
    return _with_lengths(
        options, lambda _, default: None if default is None else 1.0, lambda record: without_lengths(record)
    )


def _with_lengths(options: Options, change: Callable[[Any, Any], Any], inside: Callable[[Any], Any]) -> Options:
    changes: dict[str, Any] = {}
    for each in fields(options):  # type: ignore[arg-type]
        value = getattr(options, each.name)
        if each.metadata.get("unit") == "m":
            changes[each.name] = change(value, each.default)
        elif is_dataclass(value):
            changes[each.name] = inside(value)
        elif isinstance(value, tuple):
            changes[each.name] = tuple(inside(item) if is_dataclass(item) else item for item in value)
    changed: Options = replace(options, **changes)  # type: ignore[type-var]
    return changed
