"""What the stages can be told: plain frozen structs, every length in meters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from torchreg.errors import at_least, expect, fraction, one_of, positive

if TYPE_CHECKING:
    from torchreg.solvers.ransac import RansacOptions

EQUALIZATIONS = ("none", "cloud", "joint")
COLOR_BLOCKS = ("pcfh", "contrast", "learned")
SOLVERS = ("ransac", "compatibility")
EFFORTS = ("plain", "fast", "balanced", "thorough")


def _ransac() -> RansacOptions:
    from torchreg.solvers.ransac import RansacOptions

    return RansacOptions()


@dataclass(frozen=True, kw_only=True)
class RegistrationOptions:
    """Everything that ``register`` uses. The defaults are the paper's (section 4.1), for scans of buildings.

    Attributes:
        voxel_size: meters; the clouds are averaged over cubes of this edge first; ``None`` takes them as
            they are.
        normal_radius: meters, the support of a normal.
        normal_max_neighbors: nearest points within it, the point itself counted.
        feature_radius: meters, the support radius of FPFH.
        feature_max_neighbors: nearest points within it, the point itself counted.
        color: the color blocks beside FPFH: ``"pcfh"`` (the paper's histograms of differences) and
            ``"contrast"`` (spread and shift of brightness per channel at two radii), ``"learned"`` (histograms
            with trained bins and weights, see ``LEARNED``); empty for geometry alone. Clouds without colors use
            none.
        color_weights: weight of each of them beside the FPFH block, all of unit length before it.
        root: in [0, 1], how far the entries of FPFH and PCFH are moved towards their square roots before they are
            fused: 0 (the paper) leaves them, 1 compares histograms by Hellinger's distance.
        color_radius: meters, the support radius of the color blocks.
        color_bins: bins of every PCFH histogram.
        color_channels: which of hue, saturation and value PCFH compares.
        equalization: histogram equalization of hue: ``"none"``, per ``"cloud"``, or ``"joint"`` over the pair.
        saturation_weighting: PCFH votes on hue count by the saturation of both points, so that gray has no say.
        ratio: a match stays when its distance is below this fraction of the second nearest's; ``None``
            leaves the test out.
        match_neighbors: a match stands when each point is among the other's so many nearest in feature space.
        solver: what turns matches into poses: ``"ransac"`` or ``"compatibility"``.
        ransac: how hypotheses are drawn and accepted; its inlier threshold holds for both solvers.
        effort: ``"plain"`` is the paper's procedure with these features and this solver, and stops there. The
            others let several candidate poses compete on the clouds themselves, refine them and judge the
            winner: ``"fast"`` from one set of features, ``"balanced"`` from two, ``"thorough"`` from all sets
            and both solvers. Asked for as ``register(effort="fast")``, all lengths grow by half and voxels thin
            the points; the result holds the lengths used.
    """

    voxel_size: float | None = None
    normal_radius: float = 2.0
    normal_max_neighbors: int = 30
    feature_radius: float = 5.0
    feature_max_neighbors: int = 100
    color: tuple[str, ...] = ("pcfh",)
    color_weights: tuple[float, ...] = (1.0,)
    root: float = 0.0
    color_radius: float = 2.0
    color_bins: int = 11
    color_channels: tuple[str, ...] = ("hue",)
    equalization: str = "cloud"
    saturation_weighting: bool = False
    ratio: float | None = None
    match_neighbors: int = 1
    solver: str = "ransac"
    ransac: RansacOptions = field(default_factory=_ransac)
    effort: str = "plain"

    def __post_init__(self) -> None:
        if self.voxel_size is not None:
            positive(self.voxel_size, "voxel_size")
        for name in ("normal_radius", "feature_radius", "color_radius"):
            positive(getattr(self, name), name)
        at_least(self.normal_max_neighbors, "normal_max_neighbors", 3)
        at_least(self.feature_max_neighbors, "feature_max_neighbors", 3)
        at_least(self.color_bins, "color_bins", 1)
        for block in self.color:
            one_of(block, "color", COLOR_BLOCKS)
        fraction(self.root, "root", zero=True)
        for weight in self.color_weights:
            positive(weight, "color_weights")
        expect(
            len(self.color_weights) == len(self.color),
            "color_weights",
            f"one per color block ({len(self.color)})",
            self.color_weights,
        )
        one_of(self.equalization, "equalization", EQUALIZATIONS)
        for channel in self.color_channels:
            one_of(channel, "color_channels", ("hue", "saturation", "value"))
        expect(len(self.color_channels) > 0, "color_channels", "at least one channel", self.color_channels)
        if self.ratio is not None:
            fraction(self.ratio, "ratio")
            expect(self.match_neighbors == 1, "match_neighbors", "1 beside a ratio", self.match_neighbors)
        at_least(self.match_neighbors, "match_neighbors", 1)
        one_of(self.solver, "solver", SOLVERS)
        one_of(self.effort, "effort", EFFORTS)
