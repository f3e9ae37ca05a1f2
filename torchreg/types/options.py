"""What the stages can be told: plain frozen structs, every length in meters."""

from __future__ import annotations

from dataclasses import dataclass, field

from torchreg.errors import at_least, expect, fraction, one_of, positive

EQUALIZATIONS = ("none", "cloud", "joint")
COLOR_BLOCKS = ("pcfh", "contrast", "learned")
SCORINGS = ("count", "msac")
SOLVERS = ("ransac", "compatibility")
EFFORTS = ("plain", "fast", "balanced", "thorough")


@dataclass(frozen=True, kw_only=True)
class RansacOptions:
    """How hypotheses are drawn, tested and accepted. The defaults are the paper's (section 4.1), but for ``scoring``.

    Attributes:
        hypotheses: how many minimal samples are drawn at most.
        confidence: drawing stops once a better sample would have been drawn with this probability;
            1.0 draws all of them.
        edge_similarity: in [0, 1]; a sample stays when each edge's length in the one cloud is at least
            this fraction of its length in the other.
        inlier_threshold: meters; a correspondence farther apart than this after the transform is an outlier.
        sample_size: correspondences in a minimal sample, at least 3.
        local_optimization: rounds of refitting to the inliers of the best hypotheses; 0 keeps the minimal
            solution.
        scoring: what transforms are compared by: ``"count"`` of inliers, or ``"msac"``, where an inlier counts
            for 1 - (residual / threshold)^2. When to stop drawing follows from the count alone.
    """

    hypotheses: int = 600_000
    confidence: float = 0.999
    edge_similarity: float = 0.9
    inlier_threshold: float = 0.2
    sample_size: int = 3
    local_optimization: int = 10
    scoring: str = "msac"

    def __post_init__(self) -> None:
        at_least(self.hypotheses, "hypotheses", 1)
        fraction(self.confidence, "confidence")
        fraction(self.edge_similarity, "edge_similarity", zero=True)
        positive(self.inlier_threshold, "inlier_threshold")
        at_least(self.sample_size, "sample_size", 3)
        at_least(self.local_optimization, "local_optimization", 0)
        one_of(self.scoring, "scoring", SCORINGS)


@dataclass(frozen=True, kw_only=True)
class CompatibilityOptions:
    """How sets of correspondences that keep their distances are found and accepted.

    Attributes:
        inlier_threshold: meters; a correspondence farther apart than this after the transform is an outlier, and
            two correspondences agree when their distances in the two clouds differ by less.
        nodes: correspondences that are compared each with each, at most 4,095; of more, those that agree with more
            others than chance gives are taken. Memory grows with the square, time with the cube.
        partners: in the first set of a seed, those that share the most partners with it.
        members: of its final set, the seed counted.
        local_optimization: rounds of refitting to the inliers of the best transforms; 0 keeps those of the sets.
        scoring: what transforms are compared by: ``"count"`` of inliers, or ``"msac"``, where an inlier counts
            for 1 - (residual / threshold)^2.
    """

    inlier_threshold: float = 0.2
    nodes: int = 2000
    partners: int = 30
    members: int = 20
    local_optimization: int = 10
    scoring: str = "msac"

    def __post_init__(self) -> None:
        positive(self.inlier_threshold, "inlier_threshold")
        at_least(self.nodes, "nodes", 3)
        expect(self.nodes <= 4095, "nodes", "at most 4095", self.nodes)
        at_least(self.members, "members", 3)
        at_least(self.partners, "partners", self.members - 1)
        at_least(self.local_optimization, "local_optimization", 0)
        one_of(self.scoring, "scoring", SCORINGS)


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
    ransac: RansacOptions = field(default_factory=RansacOptions)
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
