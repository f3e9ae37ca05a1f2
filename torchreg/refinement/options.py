"""The options of ``icp``."""

from __future__ import annotations

from dataclasses import dataclass

from torchreg.arguments import checked_record
from torchreg.errors import at_least, expect, fraction, one_of, positive
from torchreg.refinement.colored import COLORED
from torchreg.refinement.colored_generalized import COLORED_GENERALIZED
from torchreg.refinement.estimator import IcpKind
from torchreg.refinement.generalized import GENERALIZED
from torchreg.refinement.hue_point_to_point import HUE_POINT_TO_POINT
from torchreg.refinement.kernels import KERNELS
from torchreg.refinement.point_to_plane import POINT_TO_PLANE
from torchreg.refinement.point_to_point import POINT_TO_POINT

KINDS: dict[str, IcpKind] = {
    "point_to_point": POINT_TO_POINT,
    "point_to_plane": POINT_TO_PLANE,
    "colored": COLORED,
    "generalized": GENERALIZED,
    "colored_generalized": COLORED_GENERALIZED,
    "hue_point_to_point": HUE_POINT_TO_POINT,
}


@checked_record
@dataclass(frozen=True, kw_only=True)
class IcpLevel:
    """One level of a coarse-to-fine refinement.

    Attributes:
        voxel_size: meters; both clouds are averaged over cubes of this edge first; ``None`` takes them as they are.
        max_distance: meters; a point has a correspondence when its nearest target point is nearer than this.
        iterations: updates at most.

    Raises:
        ValueError: a length that is not above 0, fewer than 1 iterations.
    """

    voxel_size: float | None = None
    max_distance: float = 0.2
    iterations: int = 30

    def __post_init__(self) -> None:
        if self.voxel_size is not None:
            positive(self.voxel_size, "voxel_size")
        positive(self.max_distance, "max_distance")
        at_least(self.iterations, "iterations", 1)


@checked_record
@dataclass(frozen=True, kw_only=True)
class IcpOptions:
    """How ``icp`` refines. The numbers of convergence and color are Open3D's defaults.

    Attributes:
        max_distance: meters; a point has a correspondence when its nearest target point is nearer than this.
        kind: what is minimized: the distance ``"point_to_point"``, the distance ``"point_to_plane"`` (the target
            needs normals), the latter together with differences of intensity, ``"colored"`` (the target needs
            normals, both clouds need colors), or the distance weighed by the planes of both points, ``"generalized"``
            (both clouds need normals; the kernel's scale is then of whitened residuals, meters along surfaces). In
            ``"colored_generalized"`` and ``"hue_point_to_point"`` correspondences are the nearest by place and color
            (both clouds need colors): L, a and b beside the weighing of ``"generalized"``, and hue beside the distance
            of ``"point_to_point"``. ``max_distance`` then bounds the distance in all these dimensions.
        iterations: updates at most.
        relative_fitness: iteration stops when fitness changes by less than this in one update ...
        relative_rmse: ... and inlier_rmse by less than this, meters. Both are differences, as in Open3D, which
            has the same names.
        kernel: ``None`` for least squares, or the loss that makes far correspondences count less: ``"huber"``,
            ``"tukey"`` or ``"geman_mcclure"``.
        kernel_scale: the residual from which the kernel reduces weights, meters; squared meters for
            ``"geman_mcclure"``, where it stands beside a squared residual, as in Open3D.
        color_weight: in [0, 1], share of the intensity term beside the geometric one in ``"colored"``; Open3D's
            ``lambda_geometric`` is one minus this.
        color_scale: meters that the difference between black and white counts for (between opposite hues, of
            ``"hue_point_to_point"``) where correspondences are the nearest by place and color; ``None`` takes the
            largest distance of each level.
        levels: coarse to fine; empty for one level of ``max_distance`` and ``iterations``, which levels replace.

    Raises:
        ValueError: a number out of its range or an unknown name.

    Example:
        >>> import torchreg as tr
        >>> tr.IcpOptions(kind="point_to_plane", max_distance=0.1).iterations
        30
    """

    max_distance: float = 0.2
    kind: str = "point_to_point"
    iterations: int = 30
    relative_fitness: float = 1e-6
    relative_rmse: float = 1e-6
    kernel: str | None = None
    kernel_scale: float = 0.1
    color_weight: float = 0.032
    color_scale: float | None = None
    levels: tuple[IcpLevel, ...] = ()

    def __post_init__(self) -> None:
        positive(self.max_distance, "max_distance")
        one_of(self.kind, "kind", tuple(KINDS))
        at_least(self.iterations, "iterations", 1)
        positive(self.relative_fitness, "relative_fitness")
        positive(self.relative_rmse, "relative_rmse")
        if self.kernel is not None:
            one_of(self.kernel, "kernel", tuple(KERNELS))
        positive(self.kernel_scale, "kernel_scale")
        fraction(self.color_weight, "color_weight", zero=True)
        if self.color_scale is not None:
            positive(self.color_scale, "color_scale")
        levels = isinstance(self.levels, tuple) and all(isinstance(level, IcpLevel) for level in self.levels)
        expect(levels, "levels", "a tuple of IcpLevel", self.levels)

    @property
    def steps(self) -> tuple[IcpLevel, ...]:
        """The levels; without any, one of ``max_distance`` and ``iterations``."""
        return self.levels or (IcpLevel(max_distance=self.max_distance, iterations=self.iterations),)
