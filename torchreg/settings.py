"""The settings for the registration of a pair, each declared once.

A field of ``PairSettings`` is an option of ``torchreg batch``, a column of its pairs file that changes it for one pair,
and stored in its folder; those of ``Settings`` are options of ``torchreg register`` too. Names, types, choices, bounds
and help texts all follow from the field and its ``Setting``, so to add a setting is to add a field.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from types import NoneType
from typing import Any, NamedTuple, TypeVar, get_args, get_type_hints

from torchreg.errors import at_least, expect, one_of, positive
from torchreg.io.placement import viewpoint_of_text
from torchreg.registration.options import EFFORTS, LEARNED, PAPER, RegistrationOptions
from torchreg.registration.spacing import MAX_POINTS, options_for
from torchreg.solvers import SOLVERS, RansacOptions

PRESETS: dict[str, RegistrationOptions | None] = {"default": None, "paper": PAPER, "learned": LEARNED}
"""Options to start from, by name; ``None`` derives them from the spacing of the points."""

Change = Callable[[RegistrationOptions, Any], RegistrationOptions]
_Settings = TypeVar("_Settings", bound="StageSettings")
_RANSAC = RansacOptions()


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


def _length(change: Change, text: str) -> Any:  # noqa: ANN401
    return setting(None, "Lengths", text, metavar="METERS", change=change)


def _field(name: str) -> Change:
    return lambda options, value: replace(options, **{name: value})


def _ransac_field(name: str) -> Change:
    return lambda options, value: replace(options, ransac=replace(options.ransac, **{name: value}))


def _radius(name: str, *, of_color: bool) -> Change:
    def change(options: RegistrationOptions, value: float) -> RegistrationOptions:
        radius = positive(value, name)
        changed = (replace(one, radius=radius) if one.needs_colors == of_color else one for one in options.descriptors)
        return replace(options, descriptors=tuple(changed))

    return change


@dataclass(frozen=True, kw_only=True)
class StageSettings:
    """How clouds are read, described and matched, and how RANSAC solves.

    Raises:
        ValueError: a value out of its range; the message names the setting or the field of ``RegistrationOptions``
            that it changes.
    """

    points: int | None = setting(
        None,
        "Input",
        "Keep this many points of each cloud, chosen at random before anything else; by default all of them.",
        metavar="COUNT",
        least=1,
    )
    viewpoint: str = setting(
        "auto",
        "Input",
        "Position of the scanner, towards which normals are turned. auto: as the file says; where it says nothing, "
        "the zero of its frame is assumed, and that guess is no evidence for or against a pose. origin: the scanner "
        "stood at that zero. none: not known. X,Y,Z: a known position in meters in the frame of both files.",
        metavar="auto|origin|none|X,Y,Z",
    )
    preset: str = setting(
        "default",
        "Lengths",
        "Options to start from. default: every length follows from the spacing of the points. paper: the lengths of "
        "the paper in meters, for scans of buildings, with FPFH and PCFH of equalized hue. learned: the same "
        "with color features that were trained.",
        choices=tuple(PRESETS),
    )
    voxel: float | None = _length(
        _field("voxel_size"),
        "Edge in meters of the voxels over which points are averaged first; by default only clouds of more than "
        f"{MAX_POINTS:,} points or of unequal density are averaged.",
    )
    normal_radius: float | None = _length(
        _field("normal_radius"), "Support radius of a normal, in meters; by default twice the spacing of the points."
    )
    feature_radius: float | None = _length(
        _radius("feature_radius", of_color=False),
        "Support radius of FPFH, in meters; by default 5 times the spacing of the points.",
    )
    color_radius: float | None = _length(
        _radius("color_radius", of_color=True),
        "Support radius of the color features, in meters; by default 5 times the spacing of the points.",
    )
    inlier_threshold: float | None = _length(
        _ransac_field("inlier_threshold"),
        "Distance in meters beyond which a match counts as an outlier of a transform; by default 1.5 times the spacing "
        "of the points.",
    )
    hypotheses: int | None = setting(
        None,
        "Search",
        f"Largest number of minimal samples that RANSAC draws, where it runs; by default {_RANSAC.hypotheses:,}.",
        metavar="COUNT",
        change=_ransac_field("hypotheses"),
        of_ransac=True,
    )
    confidence: float | None = setting(
        None,
        "Search",
        "Probability, above 0 up to 1, of having drawn a better sample, at which RANSAC stops drawing, where it runs; "
        f"1 draws all; by default {_RANSAC.confidence:g}.",
        metavar="PROBABILITY",
        change=_ransac_field("confidence"),
        of_ransac=True,
    )
    no_color: bool = setting(
        False,
        "Search",
        "Leave color out of the features: register by geometry alone.",
        change=lambda options, _: options.without_color(),
    )
    seed: int = setting(
        0,
        "Run",
        "Seed of every random draw, a whole number: the same seed gives the same result.",
        metavar="NUMBER",
        least=0,
    )

    def __post_init__(self) -> None:
        for name, value, known in self._given():
            if known.choices:
                one_of(value, name, known.choices)
            if known.least is not None:
                at_least(value, name, known.least)
        viewpoint_of_text(self.viewpoint)
        self._expect_readers()
        self.over(PAPER)

    def _given(self) -> list[tuple[str, Any, Setting]]:
        """Name, value and declaration of every setting that has a value."""
        values = ((name, getattr(self, name), known) for name, (_, known) in declared(type(self)).items())
        return [one for one in values if one[1] is not None and one[1] is not False]

    def over(self, options: RegistrationOptions) -> RegistrationOptions:
        """The options with the value of every setting that has one."""
        options = replace(options, solver=options.solver_named(self._solver(options)))
        for name, value, known in self._given():
            if known.change is not None:
                try:
                    options = known.change(options, value)
                except ValueError as error:
                    raise ValueError(f"{name}:{str(error).partition(':')[2]}") from None
        return options

    def _expect_readers(self) -> None:
        """Raise ``ValueError`` for a setting that nothing reads beside the others."""

    def _solver(self, options: RegistrationOptions) -> str:
        return RansacOptions.name

    def flat(self) -> dict[str, Any]:
        """All settings by name, plain numbers and texts."""
        return asdict(self)

    def with_columns(self: _Settings, columns: Mapping[str, str], where: str) -> _Settings:
        """The settings with the values of one row of a pairs file; columns of other names are ignored.

        Args:
            columns: cells that are not empty, by name.
            where: names the row in messages.

        Raises:
            ValueError: a cell that is no value of its setting, or a column whose name is nearly that of a setting.
        """
        known = declared(type(self))
        changes: dict[str, Any] = {}
        for name, text in columns.items():
            if name in known:
                changes[name] = _value(known[name].kind, text, f"{where}, column {name}")
                continue
            for close in difflib.get_close_matches(name, known, n=1, cutoff=0.8):
                expect(False, f"{where}, column {name}", f"a name unlike {close}, or that itself", name)
        try:
            return replace(self, **changes)
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class Settings(StageSettings):
    """The settings of ``torchreg register`` for a pair.

    Raises:
        ValueError: a value out of its range, or one that only RANSAC reads beside another solver.
    """

    effort: str | None = setting(
        None,
        "Search",
        "Work spent per pair; by default balanced, and plain with the presets paper and learned. plain: one set of "
        "features and one solver, as in the paper. With the others, candidate poses compete on the clouds themselves, "
        "from one set of features (fast), with a second look at pairs in doubt (balanced), or from all sets, both "
        "solvers and always two looks (thorough).",
        choices=EFFORTS,
        change=_field("effort"),
    )
    solver: str | None = setting(
        None,
        "Search",
        "What turns matches into poses; by default compatibility, and ransac with the presets paper and learned.",
        choices=tuple(SOLVERS),
    )

    def _expect_readers(self) -> None:
        start = PRESETS[self.preset] or options_for(1.0)
        solver, effort = self._solver(start), self.effort or start.effort
        for name, _, known in self._given():
            idle = known.of_ransac and solver != RansacOptions.name and effort != "thorough"
            expect(not idle, name, "the solver ransac or the effort thorough beside it", f"{solver}, {effort}")

    def _solver(self, options: RegistrationOptions) -> str:
        return options.solver.name if self.solver is None else self.solver


@dataclass(frozen=True, kw_only=True)
class PairSettings(Settings):
    """The settings of ``torchreg batch`` for its pairs. A column of the pairs file changes a setting for its pair."""

    scale: str = setting(
        "shared",
        "Lengths",
        "Clouds whose spacing sets the default lengths of a pair. shared: all that pairs link and that are about "
        "equally dense, so that each is described once. pair: its two clouds alone, as torchreg register.",
        choices=("shared", "pair"),
    )


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


def _value(kind: type, text: str, where: str) -> Any:  # noqa: ANN401
    """The value of this type in the text of a cell; ``ValueError`` where there is none."""
    words = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}[kind]
    try:
        return _SWITCH[text.lower()] if kind is bool else kind(text)
    except (ValueError, KeyError):
        raise ValueError(f"{where}: expected {words}, got {text!r}") from None


_SWITCH = {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}
