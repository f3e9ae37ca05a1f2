"""Options in meters: fields marked as lengths, so that all lengths of a record change together.

A record marks its lengths where it declares them (``radius: float = length()``); scaling options, and comparing them
without their lengths, follow from that mark.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import MISSING, field, fields, is_dataclass, replace
from typing import Any, TypeVar

from torchreg.errors import positive

Options = TypeVar("Options")

_MARK = {"unit": "m"}


def length(default: Any = MISSING) -> Any:  # noqa: ANN401
    """A field of a frozen options record that is a length in meters, or ``None`` where its default is ``None``."""
    return field(default=default, metadata=_MARK)


def scaled(options: Options, factor: float) -> Options:
    """Multiply every length of a record by ``factor``, those of records inside it too; ``None`` stays ``None``.

    Raises:
        ValueError: a factor that is not a finite number above 0.
    """
    positive(factor, "factor")

    def changed(value: Any) -> Any:  # noqa: ANN401
        if isinstance(value, tuple):
            return tuple(map(changed, value))
        if not is_dataclass(value):
            return value
        return value.scaled(factor) if hasattr(value, "scaled") else scaled(value, factor)

    changes = {}
    for each in fields(options):  # type: ignore[arg-type]
        value = getattr(options, each.name)
        is_length = each.metadata == _MARK and value is not None
        changes[each.name] = factor * value if is_length else changed(value)
    grown: Options = replace(options, **changes)  # type: ignore[type-var]
    return grown


def besides_lengths(options: object) -> Hashable:
    """A key of everything in a record but its lengths: equal exactly where two records differ in lengths alone."""
    if isinstance(options, tuple):
        return tuple(map(besides_lengths, options))
    if not is_dataclass(options):
        return options
    kept = [each.name for each in fields(options) if each.metadata != _MARK and each.compare]
    return (type(options), *(besides_lengths(getattr(options, name)) for name in kept))
