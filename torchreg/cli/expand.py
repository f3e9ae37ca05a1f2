"""Parameters that several commands share, named once as the fields of a dataclass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, get_type_hints


def expanded(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose dataclass parameters are spelled out: each of their fields is an option of its own.

    Typer reads the signature of what this returns; the command itself gets the dataclasses, filled.

    Args:
        command: a function whose parameters typer understands, or are dataclasses of such fields.

    Example:
        >>> from dataclasses import dataclass
        >>> @dataclass
        ... class Place:
        ...     x: float
        ...     y: float = 0.0
        >>> @expanded
        ... def show(place: Place, loud: bool = False) -> None:
        ...     print(place, loud)
        >>> signature(show)
        <Signature (*, x: float, y: float = 0.0, loud: bool = False) -> None>
        >>> show(x=1.0, loud=True)
        Place(x=1.0, y=0.0) True
    """
    hints = get_type_hints(command, include_extras=True)
    spelled: list[Parameter] = []
    groups: dict[str, Any] = {}
    for name, parameter in signature(command).parameters.items():
        if is_dataclass(hints[name]):
            groups[name] = hints[name]
            spelled += _fields_of(hints[name])
        else:
            spelled.append(parameter.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[name]))

    whole = Signature(spelled, return_annotation=None)

    @wraps(command)
    def run(**given: Any) -> None:  # noqa: ANN401
        words = whole.bind(**given)
        words.apply_defaults()
        values = dict(words.arguments)
        filled = {
            name: group(**{one.name: values.pop(one.name) for one in fields(group)}) for name, group in groups.items()
        }
        command(**filled, **values)

    run.__signature__ = whole  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in spelled} | {"return": None}
    return run


def _fields_of(group: type) -> list[Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        Parameter(
            one.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if one.default is MISSING else one.default,
            annotation=hints[one.name],
        )
        for one in fields(group)
    ]
