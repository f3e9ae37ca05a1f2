"""What may be set for the registration of a pair, each setting declared once.

A field of ``PairSettings`` is an option of ``torchreg batch``, a column of its pairs file that changes it for one pair,
and part of what its folder remembers; those of ``Settings`` are options of ``torchreg register`` too. Names, types,
choices, bounds and help texts all follow from the field and its ``Setting``, so to add a setting is to add a field.
"""

# Without annotations from __future__: those of the fields are values, which ``declared`` reads.

import difflib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from types import NoneType
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_type_hints

from torchreg.errors import at_least, expect, one_of
from torchreg.io.placement import viewpoint_of_text
from torchreg.registration.presets import PAPER
from torchreg.registration.scale import MAX_POINTS, scaled_options
from torchreg.types import RansacOptions, RegistrationOptions
from torchreg.types.options import EFFORTS, SOLVERS

PRESETS: dict[str, RegistrationOptions | None] = {"default": None, "paper": PAPER}
"""Options to start from, by name; ``None`` derives them from the spacing of the points."""

Change = Callable[[RegistrationOptions, Any], RegistrationOptions]
_Settings = TypeVar("_Settings", bound="StageSettings")


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What is known of a setting beside its name, type and default.

    Attributes:
        help: a sentence with its unit, and its default where that is ``None``.
        panel: the heading that it stands under in help texts.
        metavar: what stands for its value there; ``None`` shows the choices or the type.
        choices: the names that it may have; empty for any value.
        least: the least that a whole number may be.
        change: returns the options with its value in place; ``None`` where it changes no ``RegistrationOptions``.
        of_ransac: whether only RANSAC reads it.
    """

    help: str
    panel: str
    metavar: str | None = None
    choices: tuple[str, ...] = ()
    least: int | None = None
    change: Change | None = None
    of_ransac: bool = False


def _field(name: str) -> Change:
    return lambda options, value: replace(options, **{name: value})


def _ransac_field(name: str) -> Change:
    return lambda options, value: replace(options, ransac=replace(options.ransac, **{name: value}))


def _length(text: str, change: Change) -> Setting:
    return Setting(help=text, panel="Lengths", metavar="METERS", change=change)


@dataclass(frozen=True, kw_only=True)
class StageSettings:
    """How clouds are read, described and matched, and how RANSAC solves.

    Raises:
        ValueError: a value that cannot be meant; the message names the setting or the field of
            ``RegistrationOptions`` that it changes.
    """

    points: Annotated[
        int | None,
        Setting(
            help="Keep this many points of each cloud, chosen at random before anything else; by default all of them.",
            panel="Input",
            metavar="COUNT",
            least=1,
        ),
    ] = None
    viewpoint: Annotated[
        str,
        Setting(
            help="Position of the scanner, towards which normals are turned. auto: as the file says, else the zero of "
            "its frame. origin: that zero. none: not known. X,Y,Z: a position in meters in the frame of both files.",
            panel="Input",
            metavar="auto|origin|none|X,Y,Z",
        ),
    ] = "auto"
    preset: Annotated[
        str,
        Setting(
            help="Options to start from. default: every length follows from the spacing of the points. paper: the "
            "lengths of the paper in meters, for scans of buildings, with FPFH and PCFH of equalized hue.",
            panel="Lengths",
            choices=tuple(PRESETS),
        ),
    ] = "default"
    voxel: Annotated[
        float | None,
        _length(
            "Edge in meters of the voxels over which points are averaged first; by default only clouds of more than "
            f"{MAX_POINTS:,} points or of unequal density are averaged.",
            _field("voxel_size"),
        ),
    ] = None
    normal_radius: Annotated[
        float | None,
        _length(
            "Support radius of a normal, in meters; by default twice the spacing of the points.",
            _field("normal_radius"),
        ),
    ] = None
    feature_radius: Annotated[
        float | None,
        _length(
            "Support radius of FPFH, in meters; by default 5 times the spacing of the points.",
            _field("feature_radius"),
        ),
    ] = None
    color_radius: Annotated[
        float | None,
        _length(
            "Support radius of the color features, in meters; by default 5 times the spacing of the points.",
            _field("color_radius"),
        ),
    ] = None
    inlier_threshold: Annotated[
        float | None,
        _length(
            "Distance in meters beyond which a match counts as an outlier of a transform; by default 1.5 times the "
            "spacing of the points.",
            _ransac_field("inlier_threshold"),
        ),
    ] = None
    hypotheses: Annotated[
        int | None,
        Setting(
            help="Largest number of minimal samples that RANSAC draws, where it runs; by default "
            f"{RansacOptions().hypotheses:,}.",
            panel="Search",
            metavar="COUNT",
            change=_ransac_field("hypotheses"),
            of_ransac=True,
        ),
    ] = None
    confidence: Annotated[
        float | None,
        Setting(
            help="Probability, above 0 up to 1, of having drawn a better sample, at which RANSAC stops drawing, where "
            f"it runs; 1 draws all; by default {RansacOptions().confidence:g}.",
            panel="Search",
            metavar="PROBABILITY",
            change=_ransac_field("confidence"),
            of_ransac=True,
        ),
    ] = None
    no_color: Annotated[
        bool,
        Setting(
            help="Leave color out of the features: register by geometry alone.",
            panel="Search",
            change=lambda options, _: replace(options, color=(), color_weights=()),
        ),
    ] = False
    seed: Annotated[
        int,
        Setting(
            help="Seed of every random draw, a whole number: the same seed gives the same result.",
            panel="Run",
            metavar="NUMBER",
            least=0,
        ),
    ] = 0

    def __post_init__(self) -> None:
        for name, (_, setting) in declared(type(self)).items():
            value = getattr(self, name)
            if value is None:
                continue
            if setting.choices:
                one_of(value, name, setting.choices)
            if setting.least is not None:
                at_least(value, name, setting.least)
        viewpoint_of_text(self.viewpoint)
        self.over(PAPER)

    def over(self, options: RegistrationOptions) -> RegistrationOptions:
        """The options with everything that is set in its place; effort and solver are for ``register`` to change."""
        for name, (_, setting) in declared(type(self)).items():
            value = getattr(self, name)
            if setting.change is not None and value is not None and value is not False:
                options = setting.change(options, value)
        return options

    def flat(self) -> dict[str, Any]:
        """All settings by name, plain numbers and texts."""
        return asdict(self)

    def with_columns(self: _Settings, columns: Mapping[str, str], where: str) -> _Settings:
        """The settings with the cells of one row of a pairs file in their place; other columns are left alone.

        Args:
            columns: cells that are not empty, by name.
            where: names the row in messages.

        Raises:
            ValueError: a cell that is no value of its setting, or a column whose name is nearly that of one.
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
    """All that ``torchreg register`` takes for a pair. ``effort`` and ``solver`` are as ``register`` has them.

    Raises:
        ValueError: a value that cannot be meant, or one that only RANSAC reads where it is not among the solvers.
    """

    effort: Annotated[
        str | None,
        Setting(
            help="Work spent per pair; by default balanced, and plain with the preset paper. plain: one set of "
            "features and one solver, as in the paper. With the others, candidate poses compete on the clouds "
            "themselves, from one set of features (fast), two (balanced), or all sets and both solvers (thorough).",
            panel="Search",
            choices=EFFORTS,
        ),
    ] = None
    solver: Annotated[
        str | None,
        Setting(
            help="What turns matches into poses; by default compatibility, and ransac with the preset paper.",
            panel="Search",
            choices=SOLVERS,
        ),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        start = PRESETS[self.preset] or scaled_options(1.0)
        effort, solver = self.effort or start.effort, self.solver or start.solver
        read = solver == "ransac" or effort == "thorough"
        for name, (_, setting) in declared(type(self)).items():
            idle = setting.of_ransac and getattr(self, name) is not None and not read
            expect(not idle, name, "the solver ransac or the effort thorough beside it", f"{solver}, {effort}")


@dataclass(frozen=True, kw_only=True)
class PairSettings(Settings):
    """All that ``torchreg batch`` takes for its pairs. A column of the pairs file changes a setting for its pair."""

    scale: Annotated[
        str,
        Setting(
            help="Clouds whose spacing sets the default lengths of a pair. shared: all that pairs link and that are "
            "about equally dense, so that each is described once. pair: its two clouds alone, as torchreg register.",
            panel="Lengths",
            choices=("shared", "pair"),
        ),
    ] = "shared"


class Declared(NamedTuple):
    """The type of a setting without ``None``, and the rest that is known of it."""

    kind: type
    setting: Setting


def declared(group: type) -> dict[str, Declared]:
    """The settings that are fields of a dataclass, by name; other fields are left out."""
    return _declared(group)


@cache
def _declared(group: type) -> dict[str, Declared]:
    hints = get_type_hints(group, include_extras=True)
    known = {}
    for one in fields(group):
        kinds, *notes = get_args(hints[one.name]) or (None,)
        for setting in notes:
            if isinstance(setting, Setting):
                (kind,) = (kind for kind in get_args(kinds) or (kinds,) if kind is not NoneType)
                known[one.name] = Declared(kind, setting)
    return known


def _value(kind: type, text: str, where: str) -> Any:  # noqa: ANN401
    """The value that a cell spells.

    Raises:
        ValueError: it spells none of this type.
    """
    words = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}[kind]
    try:
        return _switch(text) if kind is bool else kind(text)
    except (ValueError, KeyError):
        raise ValueError(f"{where}: expected {words}, got {text!r}") from None


def _switch(text: str) -> bool:
    return {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}[text.lower()]
