"""What decides the result of a pair beside its clouds, as a batch is told it: for all pairs, and pair by pair."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from torchreg.errors import at_least, expect, one_of
from torchreg.io.placement import viewpoint_of_text
from torchreg.registration.overrides import OptionOverrides
from torchreg.types.options import EFFORTS, SOLVERS

PRESETS = ("default", "paper")
SCALES = ("shared", "pair")


@dataclass(frozen=True, kw_only=True)
class PairSettings:
    """How a pair is read and registered. A column of the pairs file with a field's name changes it for its pair.

    Attributes:
        preset: ``"default"``: lengths from the clouds' scale; ``"paper"``: the paper's, in meters.
        scale: what the default lengths follow: ``"shared"``, one scale for clouds that pairs link and whose spacings
            are about equal, so that each is described once; ``"pair"``, the two clouds alone, as ``register``.
        overrides: what is said over either; its fields are columns too.
        effort: as ``register``'s; ``None`` takes the preset's.
        solver: likewise.
        seed: of every random draw.
        points: of each cloud, chosen at random first; ``None`` takes all.
        viewpoint: ``"auto"``, ``"origin"``, ``"none"`` or ``"X,Y,Z"`` in meters, as ``read_cloud`` has it.

    Raises:
        ValueError: a value that means nothing.
    """

    preset: str = "default"
    scale: str = "shared"
    overrides: OptionOverrides = field(default_factory=OptionOverrides)
    effort: str | None = None
    solver: str | None = None
    seed: int = 0
    points: int | None = None
    viewpoint: str = "auto"

    def __post_init__(self) -> None:
        one_of(self.preset, "preset", PRESETS)
        one_of(self.scale, "scale", SCALES)
        if self.effort is not None:
            one_of(self.effort, "effort", EFFORTS)
        if self.solver is not None:
            one_of(self.solver, "solver", SOLVERS)
        at_least(self.seed, "seed", 0)
        if self.points is not None:
            at_least(self.points, "points", 1)
        viewpoint_of_text(self.viewpoint)

    def flat(self) -> dict[str, Any]:
        """All settings by name, plain numbers and texts."""
        named = asdict(self)
        return {**named.pop("overrides"), **named}

    def with_columns(self, columns: Mapping[str, str], where: str) -> PairSettings:
        """The settings with the cells of one row of a pairs file in their place; other columns are left alone.

        Args:
            columns: cells that are not empty, by name.
            where: names the row in messages.

        Raises:
            ValueError: a cell that is no value of its setting, or a column whose name is nearly that of one.
        """
        changes: dict[str, Any] = {}
        for name, text in columns.items():
            if name in _READERS:
                changes[name] = _read(name, text, where)
                continue
            close = difflib.get_close_matches(name, _READERS, n=1, cutoff=0.8)
            expect(
                not close, f"{where}, column {name}", f"a name unlike {close[0] if close else ''}, or that itself", name
            )
        try:
            said = replace(self.overrides, **{key: value for key, value in changes.items() if key in _OVERRIDES})
            rest = {key: value for key, value in changes.items() if key not in _OVERRIDES}
            return replace(self, overrides=said, **rest)
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None


def _switch(text: str) -> bool:
    return {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}[text.lower()]


_OVERRIDES = tuple(one.name for one in fields(OptionOverrides))
_READERS: dict[str, Any] = {
    **dict.fromkeys(_OVERRIDES, float),
    "hypotheses": int,
    "no_color": _switch,
    **dict.fromkeys(("preset", "scale", "effort", "solver", "viewpoint"), str),
    **dict.fromkeys(("seed", "points"), int),
}
_KINDS = {float: "a number", int: "a whole number", _switch: "true or false", str: "a text"}


def _read(name: str, text: str, where: str) -> Any:  # noqa: ANN401
    try:
        return _READERS[name](text)
    except (ValueError, KeyError):
        raise ValueError(f"{where}, column {name}: expected {_KINDS[_READERS[name]]}, got {text!r}") from None
