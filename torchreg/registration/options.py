"""Everything that ``register`` uses, as one frozen record of records, and the presets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from torchreg.descriptors import DESCRIPTORS
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.descriptors.learned import Learned, shipped_numbers
from torchreg.descriptors.pcfh import Pcfh
from torchreg.errors import at_least, expect, fraction, one_of, positive
from torchreg.solvers import SOLVERS, RansacOptions, Solver
from torchreg.types.lengths import length, scaled

AnySolver = TypeVar("AnySolver", bound=Solver)

EFFORTS = ("plain", "fast", "balanced", "thorough")


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
        match_neighbors: two points match when each is among so many nearest of the other in feature space.
        solver: the record that turns matches into poses; its inlier threshold is that of the whole registration. At
            construction also a name of ``torchreg.solvers.SOLVERS``.
        effort: work spent per pair. ``"plain"`` is the paper's procedure with these features and this solver, and
            no more. The others let several candidate poses compete on the clouds themselves, refine them and
            judge the winner: ``"fast"`` from one set of features, ``"balanced"`` from two, ``"thorough"`` from
            several and by both of the library's solvers. Lengths do not depend on it; where ``register`` derives
            them, ``options_for`` takes them half as large again for ``"fast"``.

    The names from before descriptors and solvers were records can still be read, and given to the constructor and
    ``dataclasses.replace``: ``feature_radius`` and ``feature_max_neighbors``; ``color``, ``color_weights``,
    ``color_radius``, ``color_bins``, ``color_channels``, ``equalization`` and ``saturation_weighting``; ``ransac``.

    Raises:
        ValueError: a value out of its range, no descriptor, or another number of weights than of descriptors.
        TypeError: an unknown name, or an entry of ``descriptors`` or ``solver`` that is no such record.

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
    solver: Solver
    effort: str
    # passed on by dataclasses.replace: a solver given by name then takes over the threshold of this one
    _solver_before: Solver = field(repr=False, compare=False)

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
        solver: Solver | str | None = None,
        effort: str = "plain",
        _solver_before: Solver | None = None,
        **former: Any,  # noqa: ANN401
    ) -> None:
        records = (Fpfh(radius=5.0), Pcfh(radius=2.0)) if descriptors is None else tuple(descriptors)
        shares = (1.0,) * len(records) if weights is None else tuple(weights)
        by = _solver(solver, former.pop("ransac", None), _solver_before or RansacOptions())
        records, shares = _by_former_names(records, shares, former)
        values = {
            "voxel_size": voxel_size if voxel_size is None else positive(voxel_size, "voxel_size"),
            "normal_radius": positive(normal_radius, "normal_radius"),
            "normal_max_neighbors": at_least(normal_max_neighbors, "normal_max_neighbors", 3),
            "descriptors": records,
            "weights": tuple(positive(share, "weights") for share in shares),
            "root": fraction(root, "root", zero=True),
            "ratio": ratio if ratio is None else fraction(ratio, "ratio"),
            "match_neighbors": at_least(match_neighbors, "match_neighbors", 1),
            "solver": by,
            "effort": one_of(effort, "effort", EFFORTS),
            "_solver_before": by,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        expect(len(records) > 0, "descriptors", "at least one", records)
        for record in records:
            if not isinstance(record, Descriptor):
                raise TypeError(f"descriptors: expected records such as Fpfh(radius=0.25), got {record!r}")
        expect(len(shares) == len(records), "weights", f"one per descriptor ({len(records)})", shares)
        expect(ratio is None or match_neighbors == 1, "match_neighbors", "1 beside a ratio", match_neighbors)

    @property
    def inlier_threshold(self) -> float:
        """Meters, the solver's: a match or point farther apart than this under a transform is no inlier."""
        return self.solver.inlier_threshold

    def scaled(self, factor: float) -> RegistrationOptions:
        """The same options for points ``factor`` times as far apart: every length multiplied."""
        return scaled(self, factor)

    def without_color(self) -> RegistrationOptions:
        """The same options with the descriptors alone that need no colors."""
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
    def ransac(self) -> RansacOptions:
        """The solver where it is RANSAC, else RANSAC's defaults at the same threshold."""
        return _alike(RansacOptions, self.solver)

    @property
    def _pcfh(self) -> Pcfh:
        return next((record for record in self.descriptors if isinstance(record, Pcfh)), Pcfh(radius=self.color_radius))


_FORMER_FIELDS = {  # names from before descriptors were records: which records they change, and which field of these
    "feature_radius": ("geometry", "radius"),
    "feature_max_neighbors": ("any", "max_neighbors"),
    "color_radius": ("color", "radius"),
    "color_bins": ("pcfh", "bins"),
    "color_channels": ("pcfh", "channels"),
    "equalization": ("pcfh", "equalization"),
    "saturation_weighting": ("pcfh", "saturation_weighting"),
}


def solver_by_name(name: str, like: Solver) -> Solver:
    """The solver of this name: ``like`` if it has the name, else a record with its threshold and local optimization.

    Raises:
        ValueError: no solver has this name.
    """
    return like if like.name == name else _alike(SOLVERS[one_of(name, "solver", tuple(SOLVERS))], like)


def _alike(kind: type[AnySolver], like: Solver) -> AnySolver:
    if isinstance(like, kind):
        return like
    return kind(inlier_threshold=like.inlier_threshold, local_optimization=like.local_optimization)


def _solver(solver: Solver | str | None, ransac: RansacOptions | None, before: Solver) -> Solver:
    """The solver; options under the former name ``ransac`` give any other their threshold and local optimization."""
    if solver is None or isinstance(solver, str):
        return solver_by_name("ransac" if solver is None else solver, before if ransac is None else ransac)
    if not isinstance(solver, Solver):
        raise TypeError(f"solver: expected a record such as RansacOptions(), got {solver!r}")
    if ransac is None or isinstance(solver, RansacOptions):
        return ransac or solver
    return replace(solver, inlier_threshold=ransac.inlier_threshold, local_optimization=ransac.local_optimization)


def _by_former_names(
    descriptors: tuple[Descriptor, ...], weights: tuple[float, ...], former: dict[str, Any]
) -> tuple[tuple[Descriptor, ...], tuple[float, ...]]:
    """Descriptors and weights with the values given under former names."""
    if not former or len(descriptors) != len(weights):
        return descriptors, weights
    color, color_weights = former.pop("color", None), former.pop("color_weights", None)
    changes = {name: former.pop(name) for name in _FORMER_FIELDS if name in former}
    if former:
        raise TypeError(f"RegistrationOptions has no option {next(iter(former))!r}")
    listed = list(zip(descriptors, weights, strict=True))
    colored = [item for item in listed if item[0].needs_colors]
    if color is not None:
        known = {record.name: (record, weight) for record, weight in colored}
        radius = next((record.radius for record, _ in colored), 2.0)
        for name in color:
            one_of(name, "color", tuple(key for key, kind in DESCRIPTORS.items() if kind.needs_colors))
        colored = [known.get(name, (DESCRIPTORS[name](radius=radius), 1.0)) for name in color]
    if color_weights is not None:
        expect(
            len(color_weights) == len(colored), "color_weights", f"one per color block ({len(colored)})", color_weights
        )
        colored = [
            (record, positive(weight, "color_weights"))
            for (record, _), weight in zip(colored, color_weights, strict=True)
        ]
    if color is not None or color_weights is not None:
        listed = [item for item in listed if not item[0].needs_colors] + colored

    def changed(record: Descriptor) -> Descriptor:
        kinds = {"any", "color" if record.needs_colors else "geometry", "pcfh" if isinstance(record, Pcfh) else "any"}
        name_of = {field: name for name, (kind, field) in _FORMER_FIELDS.items() if name in changes and kind in kinds}
        try:
            return replace(record, **{field: changes[name] for field, name in name_of.items()})
        except ValueError as error:
            field, _, rest = str(error).partition(":")
            raise ValueError(f"{name_of.get(field, field)}:{rest}") from None

    return tuple(changed(record) for record, _ in listed), tuple(weight for _, weight in listed)


PAPER = RegistrationOptions()
"""The paper's parameters (section 4.1), in meters, for scans of buildings: normals 2 m / 30, FPFH 5 m / 100,
PCFH of equalized hue 2 m / 11 bins, mutual matches, edge similarity 0.9, 0.2 m, 600,000 hypotheses at
confidence 0.999. Clouds are not downsampled: the paper draws 10,000 points first (``random_downsample``)."""

_WEIGHT, _ROOT = shipped_numbers()

LEARNED = replace(PAPER, descriptors=(Fpfh(radius=5.0), Learned(radius=2.0)), weights=(1.0, _WEIGHT), root=_ROOT)
"""The paper's procedure with features whose color block was trained on colored scans (``python bench/sensitivity.py
ship``): bins, channel weights, the weight of every neighbor, the block's weight and the roots of histograms. On scenes
that training never saw such features beat the paper's fixed rule (README). Lengths are the paper's, in meters; for
points of spacing s take ``LEARNED.scaled(s)`` with an inlier threshold of 1.5 s."""
