"""Types of arguments, checked by the annotations that a public function or record has anyway.

So there is one place that knows what a wrong type is, and one message: the argument's name, what its annotation asks
for, and what came. Ranges and shapes are checked where they are known, by ``torchreg.errors``.
"""

from __future__ import annotations

import functools
import inspect
import os
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import torch
from torch import Tensor

from torchreg.errors import ArgumentTypeError, described_with_type

Function = TypeVar("Function", bound=Callable[..., Any])
Record = TypeVar("Record", bound=type)


class Kind(NamedTuple):
    """What an annotation accepts."""

    accepts: Callable[[Any], bool]
    words: str  # that follow "expected"; empty where everything is accepted
    advice: Callable[[Any], str] = lambda value: ""  # how it is made of what came; empty where nothing is known


_ANYTHING = Kind(lambda value: True, "")


def checked(function: Function) -> Function:
    """Check the types of a function's arguments before it runs; ``ArgumentTypeError`` names the first wrong one."""

    @functools.wraps(function)
    def call(*args: Any, **words: Any) -> Any:  # noqa: ANN401
        if not torch.compiler.is_compiling():
            check(function, args, words)
        return function(*args, **words)

    return call  # type: ignore[return-value]


def checked_record(record: Record) -> Record:
    """Check the types of a record's fields when one is made: a decorator above ``dataclass``."""
    record.__init__ = checked(record.__init__)  # type: ignore[misc]
    return record


def check(function: Callable[..., Any], args: Sequence[Any], words: Mapping[str, Any]) -> None:
    """Check the types of the arguments of a call.

    Raises:
        ArgumentTypeError: one that its annotation does not allow; a parameter's default is always allowed.
        TypeError: arguments that no call of this function could have.
    """
    parameters = parameters_of(function)
    for value, parameter in zip(args, parameters.positional, strict=False):
        _expect(value, parameter)
    for value in args[len(parameters.positional) :]:
        _expect(value, parameters.rest)
    for name, value in words.items():
        _expect(value, parameters.named.get(name))


class Parameter(NamedTuple):
    """A parameter of a function, and what it accepts."""

    name: str
    kind: Kind
    default: object


class Parameters(NamedTuple):
    """The parameters of a function as calls name them."""

    positional: tuple[Parameter, ...]
    rest: Parameter | None  # ``*args``
    named: dict[str, Parameter]


@functools.cache
def parameters_of(function: Callable[..., Any]) -> Parameters:
    """The parameters of a function by its annotations; one without an annotation accepts everything."""
    hints = get_type_hints(function)
    positional, rest, named = [], None, {}
    for name, each in inspect.signature(function).parameters.items():
        known = Parameter(name, kind_of(hints.get(name, Any)), each.default)
        if each.kind is each.VAR_POSITIONAL:
            rest = known
        elif each.kind is not each.VAR_KEYWORD:
            named[name] = known
            if each.kind is not each.KEYWORD_ONLY:
                positional.append(known)
    return Parameters(tuple(positional), rest, named)


def kind_of(annotation: Any) -> Kind:  # noqa: ANN401
    """What an annotation accepts; everything where it cannot be told from a value."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        return _any_of([kind_of(each) for each in inner])
    if origin is Literal:
        return Kind(lambda value: value in inner, " or ".join(map(repr, inner)))
    if origin in (tuple, Sequence) and inner:
        return _sequence_of(origin, inner)
    if origin is os.PathLike:
        return Kind(lambda value: isinstance(value, os.PathLike), "a path")
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    kind = origin if origin is not None else annotation
    if not isinstance(kind, type) or kind in (Any, object) or getattr(kind, "_is_protocol", False):
        return _ANYTHING
    advice = getattr(kind, "_made_of", _ANYTHING.advice)
    return Kind(lambda value: isinstance(value, kind), _NAMES.get(kind, kind.__name__), advice)


def _any_of(kinds: Sequence[Kind]) -> Kind:
    if not all(kind.words for kind in kinds):
        return _ANYTHING
    return Kind(
        lambda value: any(kind.accepts(value) for kind in kinds),
        " or ".join(dict.fromkeys(kind.words for kind in kinds)),
    )


def _sequence_of(origin: type, inner: tuple[Any, ...]) -> Kind:
    """Any sequence but a text passes for a tuple: where only a tuple will do, the function says so."""
    kinds = [kind_of(each) for each in inner if each is not Ellipsis]
    fixed = origin is tuple and Ellipsis not in inner

    def accepts(value: object) -> bool:
        if isinstance(value, (str, bytes)) or not isinstance(value, Sequence):
            return False
        if fixed:
            each = zip(value, kinds, strict=True) if len(value) == len(kinds) else None
            return each is not None and all(kind.accepts(part) for part, kind in each)
        return not kinds[0].words or all(map(kinds[0].accepts, value))

    if fixed:
        return Kind(accepts, f"({', '.join(kind.words or 'anything' for kind in kinds)})")
    return Kind(accepts, f"a sequence of {_several(kinds[0].words)}" if kinds[0].words else "a sequence")


def _is_number(kind: type) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, kind) and not isinstance(value, bool)


def _several(words: str) -> str:
    article, _, noun = words.partition(" ")
    return f"{noun}s" if article in ("a", "an") else words


_PLAIN: dict[Any, Kind] = {
    float: Kind(_is_number(Real), "a number"),
    int: Kind(_is_number(Integral), "an integer"),
    type(None): Kind(lambda value: value is None, "None"),
}

_NAMES = {
    Tensor: "a tensor",
    str: "a string",
    bool: "True or False",
    torch.Generator: "a torch.Generator",
    torch.dtype: "a torch.dtype",
    torch.device: "a torch.device",
    Sequence: "a sequence",
    Iterable: "an iterable",
    Callable: "a function",
}


def expect_kind(value: object, name: str, kind: Kind) -> None:
    """Raise ``ArgumentTypeError`` with the argument's name, what was expected and what came, unless it is accepted."""
    if not kind.accepts(value):
        advice = kind.advice(value)
        wanted = f"{kind.words}, such as {advice}," if advice else f"{kind.words},"
        raise ArgumentTypeError(f"{name}: expected {wanted} got {described_with_type(value)}")


def _expect(value: object, parameter: Parameter | None) -> None:
    if parameter is not None and value is not parameter.default:
        expect_kind(value, parameter.name, parameter.kind)
