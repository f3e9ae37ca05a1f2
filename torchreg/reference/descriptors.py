"""FPFH of torchreg against Open3D's, row by row, with the same points, normals and neighborhoods."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.fpfh import fpfh
from torchreg.errors import expect_in_words
from torchreg.reference import stages
from torchreg.reference.ties import ROUNDING, Tie, find_ties
from torchreg.types import Clouds, Neighborhoods

TOLERANCES = {torch.float64: 1e-6, torch.float32: 1e-2}
"""Of a histogram value; a row sums to 600."""

NAMED = 20
"""So many ties are named, those that touch rows that are off before the others."""


@dataclass(frozen=True, kw_only=True)
class DescriptorDifference:
    """How far the FPFH of one cloud are from Open3D's, which is computed in float64 in any case.

    Attributes:
        cloud: which one.
        dtype: "float64" or "float32", of torchreg's input and result.
        rows: how many there are.
        tolerance: a row is off when one of its 33 values is off by more.
        largest: the largest absolute difference.
        off: how many rows are off.
        tied: how many rows rounding in this dtype may move: a pair in their own or a neighbor's histogram is a tie.
        off_without_tie: how many rows are off though they have none.
        tie_count: how many pairs are ties.
        ties: the first of them.
    """

    cloud: str
    dtype: str
    rows: int
    tolerance: float
    largest: float
    off: int
    tied: int
    off_without_tie: int
    tie_count: int
    ties: tuple[Tie, ...]

    @property
    def share_off(self) -> float:
        """Share of rows that are off; 0 for an empty cloud."""
        return self.off / max(self.rows, 1)

    @property
    def agree(self) -> bool:
        """Whether all rows without a tie are within the tolerance."""
        return self.off_without_tie == 0


def descriptor_differences(
    cloud: Clouds, radius: float, max_neighbors: int, name: str = "cloud"
) -> tuple[DescriptorDifference, DescriptorDifference]:
    """Compare in float64 and in float32, both against Open3D on exactly the same numbers.

    Args:
        cloud: one cloud with normals.
        radius: meters, the support radius.
        max_neighbors: the nearest so many within it, the point itself counted.
        name: of the cloud, for the result.

    Raises:
        ValueError: several clouds, or no normals.
        ImportError: Open3D is not there.
    """
    expect_in_words(len(cloud) == 1, "cloud", "a batch of one", f"{len(cloud)} clouds")
    narrow = cloud.to("cpu", torch.float32)
    by_open3d = _by_open3d(cloud, radius, max_neighbors)
    same = cloud.points.dtype == torch.float32
    in_float64 = _difference(cloud.to("cpu", torch.float64), by_open3d, name)
    in_float32 = _difference(narrow, by_open3d if same else _by_open3d(narrow, radius, max_neighbors), name)
    return in_float64, in_float32


class _ByOpen3d(NamedTuple):
    cloud: Clouds
    near: Neighborhoods
    values: Tensor


def _by_open3d(cloud: Clouds, radius: float, max_neighbors: int) -> _ByOpen3d:
    exact = cloud.to("cpu", torch.float64)
    values = stages.fpfh(exact, radius, max_neighbors).values
    return _ByOpen3d(exact, stages.neighborhoods(exact, radius, max_neighbors), values)


def _difference(cloud: Clouds, reference: _ByOpen3d, name: str) -> DescriptorDifference:
    dtype = cloud.points.dtype
    near = reference.near
    values = fpfh(cloud, replace(near, sq_distance=near.sq_distance.to(dtype))).values.double()
    apart = (values - reference.values).abs().amax(dim=1)
    # not "greater than": NaN is off
    off = ~(apart <= TOLERANCES[dtype])
    ties = find_ties(reference.cloud, near, ROUNDING[dtype])
    named = sorted(ties.pairs, key=lambda tie: not bool(off[tie.row]))[:NAMED]
    return DescriptorDifference(
        cloud=name,
        dtype=str(dtype).removeprefix("torch."),
        rows=len(apart),
        tolerance=TOLERANCES[dtype],
        largest=float(apart.max()) if len(apart) > 0 else 0.0,
        off=int(off.sum()),
        tied=int(ties.touched.sum()),
        off_without_tie=int((off & ~ties.touched).sum()),
        tie_count=len(ties.pairs),
        ties=tuple(named),
    )
