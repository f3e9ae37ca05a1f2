"""Declarations of settings: what a field of a dataclass says beside its name, type and default."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cache
from types import NoneType
from typing import Any, NamedTuple, get_args, get_type_hints

from torchreg.registration.options import RegistrationOptions

Change = Callable[[RegistrationOptions, Any], RegistrationOptions]


@dataclass(frozen=True, kw_only=True)
class Setting:
    """The declaration of a setting beside its name, type and default."""

    help: str  # a sentence with its unit, and its default where that is ``None``
    panel: str  # its heading in help texts
    metavar: str | None = None  # the name of its value there; ``None`` shows the choices or the type
    choices: tuple[str, ...] = ()  # the values that it may have; empty for any
    least: int | None = None  # the least value of a whole number
    change: Change | None = None  # sets its value in options; ``None`` where it changes no ``RegistrationOptions``
    of_ransac: bool = False  # whether only RANSAC reads it


def setting(default: object, panel: str, text: str, **more: Any) -> Any:  # noqa: ANN401
    """A field of settings with its default; ``more`` are attributes of its ``Setting``."""
    return field(default=default, metadata={"setting": Setting(help=text, panel=panel, **more)})


class Declared(NamedTuple):
    """The type of a setting without ``None``, and its declaration."""

    kind: type
    setting: Setting


def declared(group: type) -> dict[str, Declared]:
    """The settings that are fields of a dataclass, by name; other fields are left out."""
    return _declared(group)


@cache  # whose type takes no dataclass
def _declared(group: type) -> dict[str, Declared]:
    hints = get_type_hints(group)
    known = {}
    for one in fields(group):
        if "setting" in one.metadata:
            (kind,) = (kind for kind in get_args(hints[one.name]) or (hints[one.name],) if kind is not NoneType)
            known[one.name] = Declared(kind, one.metadata["setting"])
    return known


def value_of(kind: type, text: str, where: str) -> Any:  # noqa: ANN401
    """The value of this type in the text of a cell; ``ValueError`` where there is none."""
    words = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}[kind]
    try:
        return _SWITCH[text.lower()] if kind is bool else kind(text)
    except (ValueError, KeyError):
        raise ValueError(f"{where}: expected {words}, got {text!r}") from None


_SWITCH = {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}
