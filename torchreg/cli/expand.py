"""Parameters that several commands share, named once as the fields of a dataclass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Annotated, Any, get_type_hints

import typer

from torchreg.declaration import declared


def expanded(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose dataclass parameters are spelled out: each of their fields is an option of its own.

    Typer reads the signature of what this returns; the command itself gets the dataclasses, filled.

    Args:
        command: a function whose parameters typer understands, or are dataclasses of such fields or of settings.

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
    parameters: list[Parameter] = []
    groups: dict[str, Any] = {}
    for name, parameter in signature(command).parameters.items():
        if is_dataclass(hints[name]):
            groups[name] = hints[name]
            parameters += _fields_of(hints[name])
        else:
            parameters.append(parameter.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[name]))

    whole = Signature(parameters, return_annotation=None)

    @wraps(command)
    def run(**given: Any) -> None:  # noqa: ANN401
        bound = whole.bind(**given)
        bound.apply_defaults()
        values = dict(bound.arguments)
        filled = {name: _filled(group, values) for name, group in groups.items()}
        command(**filled, **values)

    run.__signature__ = whole  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters} | {"return": None}
    return run


def option_of(group: type, name: str) -> Any:  # noqa: ANN401
    """The command line option of a setting."""
    setting = declared(group)[name].setting
    return typer.Option(
        _flag(name),
        help=setting.help,
        metavar=setting.metavar or (f"<{'|'.join(setting.choices)}>" if setting.choices else None),
        min=setting.least,
        rich_help_panel=setting.panel,
    )


def _fields_of(group: type) -> list[Parameter]:
    hints = get_type_hints(group, include_extras=True)
    settings = declared(group)
    parameters = []
    for one in fields(group):
        annotation, default = hints[one.name], Parameter.empty if one.default is MISSING else one.default
        if one.name in settings:
            kind, choices = settings[one.name].kind, settings[one.name].setting.choices
            if choices:
                kind = _enum(one.name, choices)
                default = None if default is None else kind(default)
            annotation = Annotated[kind if default is not None else kind | None, option_of(group, one.name)]
        parameters.append(Parameter(one.name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation))
    return parameters


def _enum(name: str, choices: tuple[str, ...]) -> Any:  # noqa: ANN401
    return Enum(name, {choice: choice for choice in choices}, type=str)


def _filled(group: type, values: dict[str, Any]) -> Any:  # noqa: ANN401
    """A dataclass filled from the values, which it takes away; settings get the plain names of their choices."""
    taken = {one.name: values.pop(one.name) for one in fields(group)}
    settings = declared(group)
    try:
        return group(**{k: v.value if k in settings and isinstance(v, Enum) else v for k, v in taken.items()})
    except ValueError as error:
        name, _, rest = str(error).partition(": ")
        raise ValueError(f"{_flag(name)}: {rest}" if name in settings else str(error)) from None


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
