"""Unique shape contexts: 3D shape contexts in SHOT's local reference frames, 1960 numbers.

Tombari, Salti and Di Stefano, 3DOR 2010, doi:10.1145/1877808.1877821. The frame of a point leaves no azimuth open, so
one description is enough where a 3D shape context needs one for every rotation; and it needs no normals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.local_frames import local_frames
from torchreg.descriptors.shape_context import shape_context
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.precision import full_precision

BINS = (14, 14, 10)
"""Of azimuth, elevation and radius."""


@full_precision
def unique_shape_context(
    cloud: Clouds,
    near: Neighborhoods,
    *,
    frames: Tensor | None = None,
    bins: tuple[int, int, int] = BINS,
    inner: float = 0.1,
    density: float = 0.2,
    binning: str = "hard",
    bandwidth: float = 1.0,
) -> Features:
    """Unique shape context of every point.

    Args:
        cloud: points; P rows. Normals are not read.
        near: the support of every point, with its radius, the point itself counted. PCL takes all neighbors within the
            radius: give enough slots.
        frames: (P, 3, 3), orthonormal axes as rows, zero where there are none; ``None`` for ``local_frames``.
        bins, inner, density, binning, bandwidth: as in ``shape_context``.

    Returns:
        Features of one block ("usc", 14 x 14 x 10 = 1960), azimuth moving slowest, radius fastest; the
        unit is 1 / m. As PCL's ``UniqueShapeContext`` with a minimal radius of ``inner`` and a density radius of
        ``density`` times the radius, within rounding but for neighbors that it moves over the edge of a cell. A point
        without a frame gets a zero row and is not valid, where PCL has NaN. All else as ``shape_context``: no gradients
        flow through hard counts, through soft ones they flow to points and frames, those of ``local_frames`` too.

    Raises:
        ValueError: neighborhoods without a radius, shapes that do not fit, or an option out of its range.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(points=torch.rand(50, 3))
        >>> tr.unique_shape_context(cloud, tr.neighbors(cloud, 0.5, 50)).values.shape
        torch.Size([50, 1960])
    """
    if frames is None:
        frames = local_frames(cloud, near)
    features = shape_context(
        cloud, near, frames=frames, bins=bins, inner=inner, density=density, binning=binning, bandwidth=bandwidth
    )
    return replace(features, blocks=(("usc", features.values.shape[1]),))


@checked_record
@dataclass(frozen=True, kw_only=True)
class UniqueShapeContext(Descriptor):
    """``torchreg.unique_shape_context``: 1960 numbers of where points lie in a local reference frame.

    Example:
        >>> import torchreg as tr
        >>> options = tr.RegistrationOptions(descriptors=(tr.UniqueShapeContext(radius=0.3),), weights=(1.0,))
        >>> options.scaled(2.0).descriptors[0].radius
        0.6
    """

    name: ClassVar[str] = "usc"
    is_batched: ClassVar[bool] = True

    @property
    def reach(self) -> float:
        """Meters: a point reads the densities of its neighbors."""
        return 2 * self.radius

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.unique_shape_context``."""
        return unique_shape_context(cloud, near)
