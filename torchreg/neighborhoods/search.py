"""The neighborhood of every point: the K nearest with d^2 < r^2, the point itself among them."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import at_least, expect, positive
from torchreg.neighborhoods.backends import backend_for
from torchreg.neighborhoods.cells import search_cells
from torchreg.neighborhoods.dense_search import search_dense
from torchreg.neighborhoods.distances import expect_searchable
from torchreg.neighborhoods.kd_tree import search_tree
from torchreg.neighborhoods.open3d_search import search_open3d
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.packing import spans

_SEARCHES = {"native": search_tree, "open3d": search_open3d, "torch": search_cells}


@entry
def neighbors(cloud: Clouds, radius: float | Tensor, max_neighbors: int, *, backend: str = "auto") -> Neighborhoods:
    """Find the ``max_neighbors`` nearest points of the same cloud within ``radius`` (a hybrid search).

    The backends agree to the last bit, with one exception: where several points tie for the last place of a row,
    ``"native"`` and ``"torch"`` keep those of smaller index and ``"open3d"`` those that its tree visits first. All
    duplicates of a point are its neighbors at distance zero, so a point with K or more of them may be missing from its
    row.

    Args:
        cloud: B clouds; points of different clouds are no neighbors.
        radius: meters, one number or one per cloud (B,); a neighbor has d^2 < radius^2, strictly, both
            rounded to the dtype of the points.
        max_neighbors: K, the slots of a row; the point itself takes one.
        backend: ``"native"`` (a k-d tree in compiled kernels, CPU), ``"open3d"`` (its tree, CPU), ``"torch"`` (any
            device), or ``"auto"``: the first of these that can.

    Returns:
        Neighborhoods of (P, K) on the device and in the dtype of the points. No gradient flows.

    Raises:
        ValueError: an argument out of its range, points that are not finite or not float32 or float64.

    Example:
        >>> cloud = Clouds(points=torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]]))
        >>> neighbors(cloud, radius=2.0, max_neighbors=2).index.tolist()
        [[0, 1], [1, 0], [2, 2]]
    """
    at_least(max_neighbors, "max_neighbors", 1)
    points = cloud.points.detach()
    expect(points.dtype in (torch.float32, torch.float64), "cloud.points", "float32 or float64", points)
    if torch.compiler.is_compiling():
        (_,) = spans(cloud.offsets, points.shape[0])
        expect(not isinstance(radius, Tensor), "radius", "one number, where a graph is captured", radius)
        square = positive(radius, "radius") ** 2  # type: ignore[arg-type]  # a number
        return Neighborhoods(*search_dense(points, square, max_neighbors), radius=radius)
    limits = _squared_radii(radius, len(cloud), points.dtype)
    expect_searchable(points, "cloud.points")
    search = _SEARCHES[backend_for(backend, points)]
    slots = search(points, spans(cloud.offsets), limits, max_neighbors)
    return Neighborhoods(*slots, radius=_per_point(radius, cloud))


def _per_point(radius: float | Tensor, cloud: Clouds) -> float | Tensor:
    """A radius per cloud as one per point (P,), or as one number where all are the same."""
    if not isinstance(radius, Tensor):
        return radius
    values = radius.tolist()
    if values and min(values) == max(values):
        return float(values[0])
    return radius.detach().repeat_interleave(torch.tensor(cloud.lengths, device=radius.device)).to(cloud.device)


def _squared_radii(radius: float | Tensor, clouds: int, dtype: torch.dtype) -> list[float]:
    """The squared radius of every cloud, rounded to ``dtype`` as the distances are."""
    if isinstance(radius, Tensor):
        expect(radius.shape == (clouds,), "radius", f"a number or one per cloud ({clouds},)", radius)
        for value in radius.tolist():
            positive(value, "radius")
        squares = (radius.detach() * radius.detach()).to("cpu", dtype)
    else:
        squares = torch.full((clouds,), positive(radius, "radius") ** 2, dtype=torch.float64).to(dtype)
    # A radius whose square underflows still holds the point itself.
    listed: list[float] = squares.clamp_min(torch.finfo(dtype).tiny).tolist()
    return listed
