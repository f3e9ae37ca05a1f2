"""Intrinsic shape signatures: points whose surroundings spread in three directions, each by another amount.

Zhong, Intrinsic shape signatures: a shape descriptor for 3D object recognition, ICCV workshops 2009,
doi:10.1109/ICCVW.2009.5457637. With the eigenvalues e1 >= e2 >= e3 of the covariance of a point's neighbors, the point
is salient where

    e2 / e1 < gamma_21   and   e3 / e2 < gamma_32,

so that its principal axes are told apart. Of the salient points those are keypoints whose e3 is not below that of any
point within the radius of non-maximum suppression.

This is Open3D's definition (``compute_iss_keypoints``): the covariance is about the mean of the neighbors. PCL's
``ISSKeypoint3D`` takes the scatter about the point itself, not divided by the number of neighbors, so that e3 grows
with the density of points and at edges, and may leave out points near borders; its two tests, the order of the steps
and the suppression are the same. The paper weighs every neighbor by one over its own number of neighbors, which
neither library does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import at_least, describe, expect, positive
from torchreg.geometry.eigen import symmetric_eigen
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.geometry.numerics.gather import gather
from torchreg.keypoints.keypoints import KeypointRows, Keypoints, KeypointSupport, rows_where
from torchreg.preprocess.normals import covariances
from torchreg.types import Clouds, Neighborhoods
from torchreg.types.lengths import length
from torchreg.types.neighborhoods import expect_rows

GAMMA = 0.975
"""Of both ratios: the default of Open3D and of PCL."""

MIN_NEIGHBORS = 5
"""The default of Open3D and of PCL."""

_FLAT = 1e-10  # of e3 to e1: below it the spread is the rounding of coordinates, and the neighbors lie on a plane


_EQUAL = 1e-9  # relative: points with the same neighbors are as salient as each other, but for rounding


@entry
def iss_keypoints(
    cloud: Clouds,
    near: Neighborhoods,
    non_max_radius: float | Tensor,
    *,
    gamma_21: float = GAMMA,
    gamma_32: float = GAMMA,
    min_neighbors: int = MIN_NEIGHBORS,
) -> KeypointRows:
    """Select the points of most distinct shape, by intrinsic shape signatures.

    Args:
        cloud: P points.
        near: the support of every point, which decides how salient it is, the point itself counted. Open3D takes all
            points within 6 mean distances of nearest neighbors.
        non_max_radius: meters, at most the radius of ``near``: a keypoint is at least as salient as all neighbors
            nearer than this (Open3D: 4 of these distances). A number, or one per point (P,).
        gamma_21: the second eigenvalue is below this share of the first.
        gamma_32: the third is below this share of the second.
        min_neighbors: fewer within either radius, the point itself counted, make no keypoint.

    Returns:
        KeypointRows, none for a cloud that is flat everywhere. The points that Open3D selects, where ``near`` holds
        all points within its radius, but for two cases that Open3D leaves to rounding: of points with the same
        neighbors, which are equally salient, the lowest row is selected, and no point of an exact plane. Computed in
        float64; the same for any batch and number of threads. No gradients.

    Raises:
        ValueError: shapes that do not fit, a ratio or radius not above 0, or ``non_max_radius`` above that of ``near``.

    Example:
        >>> faces = torch.cat([torch.rand(300, 2) @ torch.eye(3)[[i, j]] for i, j in ((0, 1), (1, 2), (2, 0))])
        >>> from torchreg.neighborhoods import neighbors
        >>> cloud = Clouds(points=faces)
        >>> len(iss_keypoints(cloud, neighbors(cloud, 0.3, 300), 0.2).rows) > 0
        True
    """
    expect_rows(near, cloud)
    positive(gamma_21, "gamma_21")
    positive(gamma_32, "gamma_32")
    at_least(min_neighbors, "min_neighbors", 1)
    _expect_within(non_max_radius, near)
    salience = _salience(cloud.points.detach(), near, gamma_21, gamma_32, min_neighbors)
    return rows_where(cloud, _is_largest(salience, near.restrict(non_max_radius), min_neighbors))


@checked_record
@dataclass(frozen=True, kw_only=True)
class IssKeypoints(Keypoints):
    """``torchreg.iss_keypoints``: points of distinct shape.

    Attributes:
        radius: meters, the support that decides how salient a point is.
        non_max_radius: meters, at most ``radius``: a keypoint is the most salient within it.
        gamma_21: as in ``iss_keypoints``.
        gamma_32: likewise.
        min_neighbors: likewise.
        max_neighbors: the nearest so many of the support are looked at.

    Raises:
        ValueError: a length, ratio or number out of its range.

    Example:
        >>> import torchreg as tr
        >>> from dataclasses import replace
        >>> options = replace(tr.options_for(spacing=0.05), keypoints=tr.IssKeypoints(radius=0.2, non_max_radius=0.1))
        >>> options.keypoints.name
        'iss'
    """

    name: ClassVar[str] = "iss"

    radius: float = length()
    non_max_radius: float = length()
    gamma_21: float = GAMMA
    gamma_32: float = GAMMA
    min_neighbors: int = MIN_NEIGHBORS
    max_neighbors: int = 100

    def __post_init__(self) -> None:
        positive(self.radius, "radius")
        positive(self.non_max_radius, "non_max_radius")
        fits = self.non_max_radius <= self.radius
        expect(fits, "non_max_radius", f"at most the radius, {self.radius} m", self.non_max_radius)
        positive(self.gamma_21, "gamma_21")
        positive(self.gamma_32, "gamma_32")
        at_least(self.min_neighbors, "min_neighbors", 1)
        at_least(self.max_neighbors, "max_neighbors", 2)

    @classmethod
    def for_spacing(cls, spacing: float) -> IssKeypoints:
        """4 and 2 spacings: Open3D's 6 and 4 leave some thirty points of a scan of a room."""
        return cls(radius=4 * spacing, non_max_radius=2 * spacing)

    @property
    def support(self) -> KeypointSupport:
        """As ``iss_keypoints`` reads them: also the neighbors' own supports."""
        return KeypointSupport(self.radius, self.max_neighbors, self.radius + self.non_max_radius)

    def select(self, cloud: Clouds, near: Neighborhoods | None) -> KeypointRows:
        """As ``torchreg.iss_keypoints``."""
        if near is None:
            raise ValueError("near: expected Neighborhoods, got None")
        ratios = {"gamma_21": self.gamma_21, "gamma_32": self.gamma_32}
        return iss_keypoints(cloud, near, self.non_max_radius, **ratios, min_neighbors=self.min_neighbors)


def _salience(points: Tensor, near: Neighborhoods, gamma_21: float, gamma_32: float, least: int) -> Tensor:
    """(P,) float64: the third eigenvalue of salient points, zero elsewhere."""
    x, y, z = (column.contiguous() for column in points.unbind(1))
    out = torch.zeros(len(points), dtype=torch.float64, device=points.device)
    for part in row_chunks(len(points), near.max_neighbors):
        covariance, count = covariances(x, y, z, near, part)
        third, second, first = symmetric_eigen(covariance)[0].unbind(-1)
        # as products: eigenvalues may be zero
        distinct = (second < gamma_21 * first) & (third < gamma_32 * second)
        thick = third > _FLAT * first
        out[part] = torch.where(distinct & thick & (count >= least), third, 0.0)
    return out


def _is_largest(salience: Tensor, near: Neighborhoods, least: int) -> Tensor:
    """(P,) bool: salient, among enough neighbors, none of which is more salient, or as salient in a lower row."""
    out = torch.zeros_like(salience, dtype=torch.bool)
    for part in row_chunks(len(salience), near.max_neighbors):
        valid, index, own = near.valid[part], near.index[part], salience[part, None]
        around = torch.where(valid, gather(salience, index), 0.0)
        row = torch.arange(part.start, part.stop, device=salience.device)[:, None]
        beaten = (around > own * (1 + _EQUAL)) | ((around >= own * (1 - _EQUAL)) & (index < row))
        out[part] = (own[:, 0] > 0) & ~beaten.any(dim=1) & (valid.sum(dim=1) >= least)
    return out


def _expect_within(radius: float | Tensor, near: Neighborhoods) -> None:
    """Check that the radius of suppression, a number or (P,), is at most that of the search, where that is known."""
    if isinstance(radius, Tensor):
        expect(radius.shape == (len(near),), "non_max_radius", f"a number or one per point ({len(near)},)", radius)
    else:
        positive(radius, "non_max_radius")
    if near.radius is None:
        return
    # compared where the neighborhoods lie: the host reads one number
    device = near.index.device
    asked, searched = (
        each.to(device, torch.float64)
        if isinstance(each, Tensor)
        else torch.tensor(each, dtype=torch.float64, device=device)
        for each in (radius, near.radius)
    )
    wider = bool((asked > searched).any())
    expect(not wider, "non_max_radius", f"at most the radius of near ({describe(near.radius)})", radius)
