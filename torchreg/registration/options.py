"""Everything that ``register`` uses, as one frozen record of records, and the presets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from torchreg.arguments import checked
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.descriptors.learned import Learned, shipped_numbers
from torchreg.descriptors.pcfh import Pcfh
from torchreg.errors import at_least, expect, fraction, one_of, positive
from torchreg.keypoints.keypoints import Keypoints
from torchreg.registration.former_names import by_former_names
from torchreg.solvers import SOLVERS, RansacOptions, Solver
from torchreg.types.lengths import length, scaled
from torchreg.types.loading import loadable

AnySolver = TypeVar("AnySolver", bound=Solver)

_AS_BEFORE: Any = object()  # in place of options of RANSAC: those that there are

EFFORTS = ("plain", "fast", "balanced", "thorough")

REFINEMENTS = ("none", "coarse", "full")
"""How far a pose is refined at the end."""

REFINE_POINTS = 20_000
"""Surfels of each cloud that a pose is refined on, about."""


@loadable
@dataclass(frozen=True, kw_only=True, init=False)
class RegistrationOptions:
    """Everything that ``register`` uses. The defaults are the paper's (section 4.1), for scans of buildings.

    Attributes:
        voxel_size: meters; the clouds are averaged over cubes of this edge first; ``None`` takes them as
            they are.
        normal_radius: meters, the support of a normal.
        normal_max_neighbors: nearest points within it, the point itself counted.
        descriptors: records of the descriptors, each with its support radius. Where a pair has no colors, those that
            need them are left out.
        weights: of the descriptors in the fused feature, all blocks being of unit length before it; ``None`` at
            construction for equal ones.
        root: in [0, 1], how far the entries of histograms are moved towards their square roots before they are
            fused: 0 (the paper) leaves them, 1 compares histograms by Hellinger's distance.
        ratio: a match stays when its distance is below this fraction of the second nearest's; ``None``
            leaves the test out.
        keypoints: the rule that selects the points that are matched, such as ``IssKeypoints``; ``None`` matches all.
            Descriptors are computed on the neighborhoods of all points, and poses are judged and refined on all points.
        match_neighbors: two points match when each is among so many nearest of the other in feature space.
        solver: the record that turns matches into poses; its inlier threshold is that of the whole registration. At
            construction and in ``dataclasses.replace`` also a name of ``torchreg.solvers.SOLVERS``, at the threshold
            that there is.
        ransac: how RANSAC draws where ``"thorough"`` runs it beside another solver, at the same threshold; the solver
            itself where that is RANSAC.
        effort: work spent per pair. ``"plain"`` is the paper's procedure with these features and this solver, and
            no more. The others let several candidate poses compete on the clouds themselves, refine them and
            judge the winner: ``"fast"`` from one set of features, ``"balanced"`` with a second look at other scales
            where no pose convinces, ``"thorough"`` from several sets, by both of the library's solvers and always with
            that second look. Lengths do not depend on it; where ``register`` derives them, ``options_for`` takes them
            half as large again for ``"fast"``.
        refine: how far the pose of a pair that succeeds is refined at the end: not at all (``"none"``, the resolution
            that it was found at), on the thinned clouds (``"coarse"``), or on the clouds as given (``"full"``), which
            goes to a part of their noise. Where ``register`` derives the options it is full, but for effort plain.
        refine_points: small planes (surfels) of each cloud that it is refined on, about: bounds the work.

    The names from before descriptors and solvers were records can still be read, and given to the constructor and
    ``dataclasses.replace``: ``feature_radius`` and ``feature_max_neighbors``; ``color``, ``color_weights``,
    ``color_radius``, ``color_bins``, ``color_channels``, ``equalization`` and ``saturation_weighting``. They change the
    records that there are: a descriptor that is taken out takes its settings with it.

    Raises:
        ValueError: a value out of its range, no descriptor, another number of weights than of descriptors, or
            ``solver`` and ``ransac`` both given at different thresholds.
        TypeError: an unknown name, or an entry of ``descriptors``, ``solver`` or ``ransac`` that is no such record.

    Example:
        >>> options = RegistrationOptions(descriptors=(Fpfh(radius=0.25),), solver="compatibility").scaled(2)
        >>> options.normal_radius, options.descriptors[0].radius, options.inlier_threshold
        (4.0, 0.5, 0.4)
    """

    voxel_size: float | None = length(None)
    normal_radius: float = length()
    normal_max_neighbors: int
    descriptors: tuple[Descriptor, ...]
    weights: tuple[float, ...]
    root: float
    ratio: float | None
    match_neighbors: int
    keypoints: Keypoints | None
    solver: Solver
    ransac: RansacOptions
    effort: str
    refine: str
    refine_points: int
    # solver and ransac once more: dataclasses.replace passes them on, and the constructor sees which of them changed
    _before: tuple[Solver, RansacOptions] = field(repr=False, compare=False)

    @checked
    def __init__(
        self,
        *,
        voxel_size: float | None = None,
        normal_radius: float = 2.0,
        normal_max_neighbors: int = 30,
        descriptors: Sequence[Descriptor] | None = None,
        weights: Sequence[float] | None = None,
        root: float = 0.0,
        ratio: float | None = None,
        match_neighbors: int = 1,
        keypoints: Keypoints | None = None,
        solver: Solver | str | None = None,
        ransac: RansacOptions = _AS_BEFORE,
        effort: str = "plain",
        refine: str = "none",
        refine_points: int = REFINE_POINTS,
        _before: tuple[Solver, RansacOptions] | None = None,
        **former: Any,  # noqa: ANN401
    ) -> None:
        records = (Fpfh(radius=5.0), Pcfh(radius=2.0)) if descriptors is None else _listed(descriptors, "descriptors")
        shares = (1.0,) * len(records) if weights is None else _listed(weights, "weights")
        _expect_records(records)
        if keypoints is not None:
            _expect_key(keypoints, "keypoints")
        expect(len(shares) == len(records), "weights", f"one per descriptor ({len(records)})", shares)
        expect(ratio is None or match_neighbors == 1, "match_neighbors", "1 beside a ratio", match_neighbors)
        records, shares = by_former_names(records, shares, former)
        both = _solvers(solver, None if ransac is _AS_BEFORE else ransac, _before)
        values = {
            "voxel_size": voxel_size if voxel_size is None else positive(voxel_size, "voxel_size"),
            "normal_radius": positive(normal_radius, "normal_radius"),
            "normal_max_neighbors": at_least(normal_max_neighbors, "normal_max_neighbors", 3),
            "descriptors": records,
            "weights": tuple(positive(share, "weights") for share in shares),
            "root": fraction(root, "root", zero=True),
            "ratio": ratio if ratio is None else fraction(ratio, "ratio"),
            "match_neighbors": at_least(match_neighbors, "match_neighbors", 1),
            "keypoints": keypoints,
            "solver": both[0],
            "ransac": both[1],
            "effort": one_of(effort, "effort", EFFORTS),
            "refine": one_of(refine, "refine", REFINEMENTS),
            "refine_points": at_least(refine_points, "refine_points", 100),
            "_before": both,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def inlier_threshold(self) -> float:
        """Meters, the solver's: a match or point farther apart than this under a transform is no inlier."""
        return self.solver.inlier_threshold

    def scaled(self, factor: float) -> RegistrationOptions:
        """The same options for points ``factor`` times as far apart: every length multiplied."""
        return scaled(self, factor)

    def solver_named(self, name: str) -> Solver:
        """The solver of this name: one of the two there are, else a record with their threshold.

        Raises:
            ValueError: no solver has this name.
        """
        return next((solver for solver in (self.solver, self.ransac) if solver.name == name), None) or _like(
            name, self.solver
        )

    def without_color(self) -> RegistrationOptions:
        """The same options with the descriptors alone that need no colors.

        Raises:
            ValueError: all of them need colors.
        """
        kept = [each for each in zip(self.descriptors, self.weights, strict=True) if not each[0].needs_colors]
        return replace(
            self, descriptors=tuple(record for record, _ in kept), weights=tuple(weight for _, weight in kept)
        )

    @property
    def feature_radius(self) -> float:
        """Meters, of the first descriptor of geometry; of the first descriptor where there is none."""
        return next((record for record in self.descriptors if not record.needs_colors), self.descriptors[0]).radius

    @property
    def feature_max_neighbors(self) -> int:
        """The most neighbors of any descriptor."""
        return max(record.max_neighbors for record in self.descriptors)

    @property
    def color(self) -> tuple[str, ...]:
        """Names of the descriptors that need colors."""
        return tuple(record.name for record in self.descriptors if record.needs_colors)

    @property
    def color_weights(self) -> tuple[float, ...]:
        """Their weights."""
        pairs = zip(self.descriptors, self.weights, strict=True)
        return tuple(weight for record, weight in pairs if record.needs_colors)

    @property
    def color_radius(self) -> float:
        """Meters, of the first of them; ``feature_radius`` where there is none."""
        return next((record.radius for record in self.descriptors if record.needs_colors), self.feature_radius)

    @property
    def color_bins(self) -> int:
        """Bins of PCFH."""
        return self._pcfh.bins

    @property
    def color_channels(self) -> tuple[str, ...]:
        """Channels of PCFH."""
        return self._pcfh.channels

    @property
    def equalization(self) -> str:
        """Equalization of hue for PCFH."""
        return self._pcfh.equalization

    @property
    def saturation_weighting(self) -> bool:
        """Whether PCFH's votes on hue count by saturation."""
        return self._pcfh.saturation_weighting

    @property
    def _pcfh(self) -> Pcfh:
        return next((record for record in self.descriptors if isinstance(record, Pcfh)), Pcfh(radius=self.color_radius))


def _solvers(
    solver: Solver | str | None, ransac: RansacOptions | None, before: tuple[Solver, RansacOptions] | None
) -> tuple[Solver, RansacOptions]:
    """The solver and the options of RANSAC, at one threshold: that of the one that changes, else of the solver."""
    _expect_solver(solver, ransac)
    old_solver, old_ransac = before or (RansacOptions(), RansacOptions())
    ransac_changes = ransac is not None and (before is None or ransac != old_ransac)
    ransac = old_ransac if ransac is None else ransac
    if solver is None:
        solver = ransac
    elif isinstance(solver, str):
        solver = ransac if solver == ransac.name else _like(solver, ransac if ransac_changes else old_solver)
    elif ransac_changes and (before is None or solver != old_solver):
        fits = solver == (ransac if isinstance(solver, RansacOptions) else _at_threshold(solver, ransac))
        expect(fits, "ransac", f"what agrees with the solver ({solver}), or none", ransac)
    elif ransac_changes:
        solver = ransac if isinstance(solver, RansacOptions) else _at_threshold(solver, ransac)
    if isinstance(solver, RansacOptions):
        return solver, solver
    return solver, _at_threshold(ransac, solver)


def _at_threshold(solver: AnySolver, other: Solver) -> AnySolver:
    return replace(solver, inlier_threshold=other.inlier_threshold)


def _like(name: str, other: Solver) -> Solver:
    """The solver of this name at the threshold of another, with its local optimization."""
    if other.name == name:
        return other
    kind = SOLVERS[one_of(name, "solver", tuple(SOLVERS))]
    return kind(inlier_threshold=other.inlier_threshold, local_optimization=other.local_optimization)


def _listed(values: Sequence[Any], name: str) -> tuple[Any, ...]:
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise TypeError(f"{name}: expected a sequence such as a tuple, got {values!r}")
    return tuple(values)


def _expect_records(records: Sequence[Descriptor]) -> None:
    expect(len(records) > 0, "descriptors", "at least one", records)
    for record in records:
        if not isinstance(record, Descriptor):
            raise TypeError(f"descriptors: expected records such as Fpfh(radius=0.25), got {record!r}")
        _expect_key(record, "descriptors")


def _expect_solver(solver: object, ransac: object) -> None:
    if not (solver is None or isinstance(solver, (str, Solver))):
        raise TypeError(f"solver: expected a record such as RansacOptions(), or a name, got {solver!r}")
    if not (ransac is None or isinstance(ransac, RansacOptions)):
        raise TypeError(f"ransac: expected RansacOptions(), got {ransac!r}")
    if isinstance(solver, Solver):
        _expect_key(solver, "solver")


def _expect_key(record: Descriptor | Solver | Keypoints, name: str) -> None:
    """Raise ``TypeError`` where a record cannot be a key of what is shared and cached."""
    kind = type(record).__name__
    if not isinstance(getattr(record, "name", None), str):
        raise TypeError(f"{name}: expected a class with a name, got {kind} without")
    try:
        hash(record)
    except TypeError:
        raise TypeError(f"{name}: expected a frozen record, tuples in place of lists, got {record!r}") from None


PAPER = RegistrationOptions()
"""The paper's parameters (section 4.1), in meters, for scans of buildings: normals 2 m / 30, FPFH 5 m / 100,
PCFH of equalized hue 2 m / 11 bins, mutual matches, edge similarity 0.9, 0.2 m, 600,000 hypotheses at
confidence 0.999. Clouds are not downsampled: the paper draws 10,000 points first (``random_downsample``)."""

_WEIGHT, _ROOT = shipped_numbers()

LEARNED = replace(PAPER, descriptors=(Fpfh(radius=5.0), Learned(radius=2.0)), weights=(1.0, _WEIGHT), root=_ROOT)
"""The paper's procedure with features whose color block was trained on colored scans (``python bench/sensitivity.py
ship``): bins, channel weights, the weight of every neighbor, the block's weight and the roots of histograms. On scenes
that training never saw such features beat the paper's fixed rule (docs/benchmarks/sensitivity.md). Lengths are the
paper's, in meters; for points of spacing s take ``LEARNED.scaled(s)`` with an inlier threshold of 1.5 s."""
