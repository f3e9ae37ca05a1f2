"""The settings for the registration of a pair, each declared once.

A field of ``PairSettings`` is an option of ``torchreg batch``, a column of its pairs file that changes it for one pair,
and stored in its folder; those of ``Settings`` are options of ``torchreg register`` too. Names, types, choices, bounds
and help texts all follow from the field and its ``Setting``, so to add a setting is to add a field.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

from torchreg.arguments import checked_record
from torchreg.declaration import Change, Setting, declared, setting, value_of
from torchreg.errors import at_least, expect, one_of, positive
from torchreg.io.placement import viewpoint_of_text
from torchreg.io.reading import Reading
from torchreg.io.units import UNITS
from torchreg.keypoints import KEYPOINTS
from torchreg.registration.options import EFFORTS, LEARNED, PAPER, REFINE_POINTS, REFINEMENTS, RegistrationOptions
from torchreg.registration.spacing import MAX_POINTS, NORMAL_SPACINGS, options_for
from torchreg.solvers import SOLVERS, RansacOptions

PRESETS: dict[str, RegistrationOptions | None] = {"default": None, "paper": PAPER, "learned": LEARNED}
"""Options to start from, by name; ``None`` derives them from the spacing of the points."""

_Settings = TypeVar("_Settings", bound="StageSettings")
_RANSAC = RansacOptions()

LARGEST_READ = 2_000_000
"""Points that the commands take from a file as they are; a larger file is thinned to no more while it is read."""


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
        "Keep this many points of each cloud, drawn at random before anything else; by default all are kept.",
        metavar="COUNT",
        least=1,
    )
    viewpoint: str = setting(
        "auto",
        "Input",
        "Where the scanner stood; normals are turned towards it. auto: where the file says, else at the zero of its "
        "frame, a guess that is no evidence for or against a pose. origin: it did stand at that zero. none: nobody "
        "knows. X,Y,Z: there, in meters, in the frame of every file.",
        metavar="auto|origin|none|X,Y,Z",
    )
    scan: str | None = setting(
        None,
        "Input",
        "Which scan of a file that has several: its number, counted from 0, or its name; by default the only one.",
        metavar="NUMBER|NAME",
    )
    target_scan: str | None = setting(
        None,
        "Input",
        "Which scan to read of the target's file; by default the one that --scan names.",
        metavar="NUMBER|NAME",
    )
    columns: str | None = setting(
        None,
        "Input",
        "What the columns of text files hold, such as 'x y z intensity red green blue', with _ for one to skip; by "
        "default a header says it, or the numbers are looked at.",
        metavar="NAMES",
    )
    units: str | None = setting(
        None,
        "Input",
        "Unit of the coordinates in the files; by default meters. file: the unit that each file names.",
        choices=UNITS,
    )
    intensity: bool = setting(False, "Input", "Use intensities as gray colors where a file has no colors.")
    preset: str = setting(
        "default",
        "Lengths",
        "Options to start from. default: every length follows from the spacing of the points. paper: the lengths of "
        "the paper, in meters, for scans of buildings, with FPFH and PCFH of equalized hue. learned: the same "
        "lengths with trained color features.",
        choices=tuple(PRESETS),
    )
    voxel: float | None = _length(
        _field("voxel_size"),
        "Edge in meters of the voxels in which points are averaged first; by default only for clouds of more than "
        f"{MAX_POINTS:,} points or of uneven density. Files of more than {LARGEST_READ:,} points are thinned "
        "while they are read in any case.",
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
        "A match is an inlier of a transform that misses it by no more than this, in meters; by default 1.5 times the "
        "spacing of the points.",
    )
    hypotheses: int | None = setting(
        None,
        "Search",
        f"How many minimal samples RANSAC draws at most, where it runs; by default {_RANSAC.hypotheses:,}.",
        metavar="COUNT",
        change=_ransac_field("hypotheses"),
        of_ransac=True,
    )
    confidence: float | None = setting(
        None,
        "Search",
        "Probability, above 0 and up to 1, of having drawn the best sample, at which RANSAC, where it runs, stops; "
        f"1 draws all samples; by default {_RANSAC.confidence:g}.",
        metavar="PROBABILITY",
        change=_ransac_field("confidence"),
        of_ransac=True,
    )
    no_color: bool = setting(
        False,
        "Search",
        "Register by geometry alone: no color in the features.",
        change=lambda options, _: options.without_color(),
    )
    seed: int = setting(
        0,
        "Run",
        "Seed of all random draws, any whole number: the same seed gives the same result.",
        metavar="NUMBER",
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

    def reading(self) -> Reading:
        """How both files are read, by cubes of half a voxel where they are large: they are averaged again later."""
        return Reading(
            viewpoint=viewpoint_of_text(self.viewpoint),
            columns=self.columns,
            units=self.units,
            voxel=None if self.voxel is None else self.voxel / 2,
            at_most=LARGEST_READ,
            intensity=self.intensity,
        )

    def scans(self) -> tuple[str | None, str | None]:
        """Which scan of the source's and of the target's file."""
        return self.scan, self.scan if self.target_scan is None else self.target_scan

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
                changes[name] = value_of(known[name].kind, text, f"{where}, column {name}")
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
        "features and one solver, as in the paper, and no verdict. With the others, candidate poses compete "
        "on the clouds themselves. fast: candidates from one set of features. balanced: and a second look at pairs in "
        "doubt. thorough: from all sets and both solvers, and always a second look.",
        choices=EFFORTS,
        change=_field("effort"),
    )
    refine: str | None = setting(
        None,
        "Search",
        "How far the pose is refined at the end; by default full, and none with the presets paper and learned and with "
        "the effort plain. none: not at all. coarse: on the thinned clouds. full: on the clouds as they were read, to "
        "a fraction of their noise, with residuals and the standard deviation of the pose.",
        choices=REFINEMENTS,
        change=_field("refine"),
    )
    refine_points: int | None = setting(
        None,
        "Search",
        f"About how many small planes of each cloud the pose is refined on; by default {REFINE_POINTS:,}.",
        metavar="COUNT",
        least=100,
        change=_field("refine_points"),
    )
    solver: str | None = setting(
        None,
        "Search",
        "What turns matches into poses; by default compatibility, and ransac with the presets paper and learned.",
        choices=tuple(SOLVERS),
    )

    keypoints: str | None = setting(
        None,
        "Search",
        "Match keypoints alone; by default all points. iss: points of distinct shape. uniform: one point of every cube "
        "of a grid. farthest: points spread as far apart as so many can be. Their lengths follow from the spacing of "
        "the points, as that of normals does.",
        choices=tuple(KEYPOINTS),
        change=lambda options, value: replace(
            options, keypoints=KEYPOINTS[value].for_spacing(options.normal_radius / NORMAL_SPACINGS)
        ),
    )

    def _expect_readers(self) -> None:
        start = PRESETS[self.preset] or options_for(1.0)
        solver, effort = self._solver(start), self.effort or start.effort
        for name, _, known in self._given():
            idle = known.of_ransac and solver != RansacOptions.name and effort != "thorough"
            if idle:
                got = f"the solver {solver} and the effort {effort}"
                raise ValueError(f"{name}: expected the solver ransac or the effort thorough beside it, got {got}")

    def _solver(self, options: RegistrationOptions) -> str:
        return options.solver.name if self.solver is None else self.solver


@checked_record
@dataclass(frozen=True, kw_only=True)
class PairSettings(Settings):
    """The settings of ``torchreg batch`` for its pairs. A column of the pairs file changes a setting for its pair.

    Example:
        >>> from torchreg.batch import PairSettings
        >>> PairSettings(effort="fast", voxel=0.05).scale
        'shared'
    """

    scale: str = setting(
        "shared",
        "Lengths",
        "Whose spacing sets the default lengths of a pair. shared: that of all clouds that pairs connect and that are "
        "about equally dense, so that each is described once. pair: that of its own two clouds, as with torchreg "
        "register.",
        choices=("shared", "pair"),
    )
