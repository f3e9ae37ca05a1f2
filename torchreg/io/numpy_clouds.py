"""To and from arrays of NumPy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from torchreg.entry import entry
from torchreg.errors import expect, expect_in_words
from torchreg.io.assemble import RawCloud, assemble, checked_dtype, scale_colors
from torchreg.io.placement import Viewpoint, checked_viewpoint
from torchreg.types import Clouds

_Array = NDArray[Any]


class NumpyCloud(NamedTuple):
    """One cloud as arrays.

    Attributes:
        points: (P, 3) float64, meters, origin included.
        colors: (P, 3) in [0, 1], in the dtype of the cloud, or ``None``.
        normals: (P, 3) of unit length, likewise.

    Example:
        >>> import torch, torchreg as tr
        >>> arrays = tr.to_numpy(tr.Clouds(torch.rand(10, 3)))
        >>> arrays.points.shape, arrays.colors is None
        ((10, 3), True)
    """

    points: NDArray[np.float64]
    colors: _Array | None
    normals: _Array | None


@entry
def from_numpy(
    points: ArrayLike,
    colors: ArrayLike | None = None,
    normals: ArrayLike | None = None,
    viewpoint: Viewpoint = "auto",
    *,
    dtype: torch.dtype = torch.float32,
) -> Clouds:
    """Make a batch of one from arrays; row i stays row i.

    Origin, colors, normals and viewpoint follow the rules of ``read_cloud``: coordinates far from zero get an origin of
    their own, colors of 8 or 16 bits become [0, 1], normals unit length. What that would leave out is refused.

    Args:
        points: (P, 3) numbers, meters.
        colors: (P, 3) from 0 to 1, or of 8 or 16 bits.
        normals: (P, 3) of any length.
        viewpoint: "auto" (zero is assumed), "origin", ``None``, or a position in the frame of the points, in meters.
        dtype: of the result, float32 or float64.

    Raises:
        ValueError: arrays of other shapes, no points, points that are not finite, or colors out of range.

    Example:
        >>> import numpy as np
        >>> from_numpy(np.zeros((1, 3)), np.array([[255, 0, 51]], dtype=np.uint8)).colors.round(decimals=3).tolist()
        [[1.0, 0.0, 0.20000000298023224]]
    """
    arrays = [None if values is None else np.asarray(values) for values in (points, colors, normals)]
    return cloud_of_arrays("points", "arrays", *arrays, viewpoint=viewpoint, dtype=dtype)  # type: ignore[arg-type]


@entry
def to_numpy(cloud: Clouds) -> NumpyCloud:
    """The arrays of one cloud, on the CPU and without gradients.

    Raises:
        ValueError: a batch of several clouds.

    Example:
        >>> to_numpy(Clouds(torch.rand(5, 3))).points.shape
        (5, 3)
    """
    expect_in_words(len(cloud) == 1, "cloud", "a batch of one (cloud[b] picks one)", f"{len(cloud)} clouds")
    local = cloud.detach().cpu()
    more = (None if values is None else values.numpy() for values in (local.colors, local.normals))
    return NumpyCloud((local.points.double() + local.origin).numpy(), *more)


def cloud_of_arrays(
    name: str,
    kind: str,
    points: _Array,
    colors: _Array | None,
    normals: _Array | None,
    *,
    viewpoint: Viewpoint,
    dtype: torch.dtype,
) -> Clouds:
    """A batch of one of arrays that ``kind`` of things hold; errors call what was given by ``name``."""
    wanted, dtype = checked_viewpoint(viewpoint), checked_dtype(dtype)
    for key, values in (("points", points), ("colors", colors), ("normals", normals)):
        if values is not None:
            expect(values.ndim == 2 and values.shape == (len(points), 3), name, f"{key} (N, 3)", values.shape)
            expect(values.dtype.kind in "iuf", name, f"{key} that are real numbers", values.dtype)
    expect_in_words(len(points) > 0, name, "at least one point", "none")
    bad = int((~np.isfinite(points).all(axis=1)).sum())
    expect_in_words(bad == 0, name, "finite points", f"{bad} of {len(points)} with NaN or infinity")
    usable = colors is None or scale_colors(colors).values is not None
    expect_in_words(usable, name, "colors from 0 to 1, or of 8 or 16 bits", "other numbers")
    raw = RawCloud(
        name=name,
        format=kind,
        points=points.astype(np.float64),
        colors=colors,
        normals=None if normals is None else normals.astype(np.float64),
    )
    return assemble(raw, wanted, dtype).cloud
