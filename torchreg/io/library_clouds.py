"""To and from the batches of clouds of PyTorch3D and PyTorch Geometric, neither of which is imported.

What comes is told by its methods and attributes; what is to be made is made by the class that is given. Positions that
go out include the origins: in the dtype of the points where all origins are zero, else in float64, so that nothing is
lost. Viewpoints stay behind. Gradients flow.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import describe, expect, expect_shape
from torchreg.types import Clouds
from torchreg.types.packing import checked_offsets, offsets_of


@entry
def from_pytorch3d(clouds: Any, *, colors: bool = True) -> Clouds:  # noqa: ANN401
    """Make clouds of ``pytorch3d.structures.Pointclouds``; features of three columns are colors.

    Args:
        clouds: with ``points_list``, ``normals_list`` and ``features_list``.
        colors: whether the features are colors; false leaves them out.

    Raises:
        ValueError: something else, or features of another width.

    Example:
        >>> import torch, torchreg as tr
        >>> class Pointclouds:  # or pytorch3d.structures.Pointclouds
        ...     def __init__(self, points):
        ...         self.points_list = lambda: points
        ...         self.normals_list = self.features_list = lambda: None
        >>> clouds = tr.from_pytorch3d(Pointclouds([torch.rand(5, 3)]))
        >>> len(clouds.points)
        5
    """
    expect(hasattr(clouds, "points_list"), "clouds", "Pointclouds of PyTorch3D", clouds)
    features = clouds.features_list() if colors else None
    for rows in features or ():
        expect(rows.shape[1] == 3, "clouds", "features of 3 columns (colors=False leaves them out)", rows)
    return Clouds.from_list(clouds.points_list(), features, clouds.normals_list())


@entry
def to_pytorch3d(clouds: Clouds, Pointclouds: Callable[..., Any]) -> Any:  # noqa: ANN401
    """Make ``Pointclouds(points=, normals=, features=)`` of B clouds, lists of tensors each; colors are the features.

    Args:
        clouds: B.
        Pointclouds: the class, ``pytorch3d.structures.Pointclouds``.

    Example:
        >>> import torch, torchreg as tr
        >>> from types import SimpleNamespace  # in place of pytorch3d.structures.Pointclouds
        >>> clouds = tr.to_pytorch3d(tr.Clouds(torch.rand(5, 3)), SimpleNamespace)
        >>> clouds.points[0].shape
        torch.Size([5, 3])
    """
    wide = _with_origins(clouds)
    of_all = (wide.points, wide.normals, wide.colors)
    points, normals, features = (None if rows is None else list(rows.split(clouds.lengths)) for rows in of_all)
    return Pointclouds(points=points, normals=normals, features=features)


@entry
def from_pyg(data: Any, *, colors: str | None = "color", normals: str | None = "normal") -> Clouds:  # noqa: ANN401
    """Make clouds of ``Data`` or ``Batch`` of PyTorch Geometric.

    Args:
        data: with ``pos`` (P, 3); where it has ``ptr`` (B+1,) or ``batch`` (P,), it is a batch of B clouds.
        colors: the attribute with the colors (P, 3), from 0 to 1 or of 8 bits; left out where there is none.
        normals: the attribute with the normals (P, 3), likewise.

    Raises:
        ValueError: something else, or a ``batch`` whose clouds do not follow one after another.

    Example:
        >>> import torch, torchreg as tr
        >>> from types import SimpleNamespace  # in place of PyTorch Geometric's Data
        >>> data = SimpleNamespace(pos=torch.rand(5, 3), color=torch.rand(5, 3), normal=None)
        >>> tr.from_pyg(data).colors.shape
        torch.Size([5, 3])
    """
    points = getattr(data, "pos", None)
    if not isinstance(points, Tensor):
        raise ValueError(f"data: expected Data or Batch of PyTorch Geometric with pos, got {describe(data)}")
    expect_shape(points, "data.pos", ("P", 3), "floating")
    return Clouds(
        points=points,
        offsets=_offsets_of(data, len(points)),
        colors=None if colors is None else _rows_of(data, colors, points),
        normals=None if normals is None else _rows_of(data, normals, points),
    )


@entry
def to_pyg(clouds: Clouds, Data: Callable[..., Any]) -> Any:  # noqa: ANN401
    """Make ``Data(pos=, color=, normal=)`` of B clouds, with ``batch`` (P,) and ``ptr`` (B+1,) unless B is 1.

    Args:
        clouds: B.
        Data: the class, ``torch_geometric.data.Data`` or ``Batch``.

    Example:
        >>> import torch, torchreg as tr
        >>> from types import SimpleNamespace
        >>> data = tr.to_pyg(tr.Clouds(torch.rand(5, 3)), SimpleNamespace)  # or PyTorch Geometric's Data
        >>> data.pos.shape
        torch.Size([5, 3])
    """
    wide = _with_origins(clouds)
    fields = {"pos": wide.points, "color": wide.colors, "normal": wide.normals}
    if len(clouds) != 1:
        offsets = clouds.offsets.to(clouds.device)
        numbers = torch.arange(len(clouds), device=clouds.device)
        fields |= {"batch": numbers.repeat_interleave(offsets.diff()), "ptr": offsets}
    return Data(**{name: value for name, value in fields.items() if value is not None})


def _rows_of(data: Any, name: str, points: Tensor) -> Tensor | None:  # noqa: ANN401
    """The attribute (P, 3) of this name in the dtype of the points, bytes scaled to [0, 1]; ``None`` without one."""
    rows = getattr(data, name, None)
    if rows is None:
        return None
    expect_shape(rows, f"data.{name}", (len(points), 3))
    scaled: Tensor = rows.to(points.dtype) / (255 if rows.dtype == torch.uint8 else 1)
    return scaled


def _offsets_of(data: Any, count: int) -> Tensor:  # noqa: ANN401
    """The offsets (B+1,) of the clouds of ``data``; of one cloud where it is no batch."""
    ptr, batch = getattr(data, "ptr", None), getattr(data, "batch", None)
    if ptr is not None:
        return checked_offsets(ptr, count, "data.ptr")
    if batch is None:
        return offsets_of([count])
    expect_shape(batch, "data.batch", (count,), torch.int64)
    listed = batch.tolist()
    expect(listed == sorted(listed), "data.batch", "clouds one after another, numbers that ascend", batch)
    return offsets_of(torch.bincount(batch.cpu()).tolist())


def _with_origins(clouds: Clouds) -> Clouds:
    """The clouds with their origins in the points; in float64 where an origin is not zero."""
    if not bool((clouds.origin != 0).any()):
        return clouds
    wide = clouds.to(torch.float64)
    counts = clouds.offsets.diff().to(clouds.device)
    return Clouds(wide.points + wide.origin.repeat_interleave(counts, dim=0), wide.offsets, wide.colors, wide.normals)
