r"""Spin images: where the neighbors of a point lie, by height over its tangent plane and distance from its normal.

Johnson and Hebert, PAMI 21(5), 1999, doi:10.1109/34.765655, as PCL has them. For a neighbor at d from a point with unit
normal n,

    beta = n.d,   alpha = |d x n|

fall between the nodes of a grid of (W + 1) x (2 W + 1), alpha in [0, s] by beta in [-s, s], and the neighbor is shared
among the four nodes around it linearly. The cylinder of that size lies in the ball of the neighborhood: s is the radius
by sqrt(2). The sums of nodes are divided by their total. A radial structure has the distance |d| in [0, radius] and the
angle over the tangent plane, asin(n.d / |d|) in [-pi/2, pi/2], instead. A grid of angles holds at each node the mean
angle between the normals, up to sign, of the neighbors there; PCL takes arccosines of float32 numbers, which hold small
angles to 5e-4 alone, where these are exact.

Linear sharing makes the image a piecewise smooth function, so gradients flow without another definition.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.descriptors.descriptor import Descriptor, largest_entries, support_radius
from torchreg.descriptors.pfh import expect_oriented
from torchreg.descriptors.soft.angle import angle
from torchreg.descriptors.soft.grids import grid_votes
from torchreg.descriptors.soft.pairs import distinct
from torchreg.descriptors.soft.rows import Piece, by_rows
from torchreg.descriptors.soft.votes import Shares
from torchreg.errors import at_least, expect, one_of
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.precision import full_precision

STRUCTURES = ("rectangular", "radial")
CONTENTS = ("counts", "angles")


@full_precision
def spin_images(
    cloud: Clouds,
    near: Neighborhoods,
    *,
    width: int = 8,
    support_cosine: float = 0.0,
    structure: str = "rectangular",
    content: str = "counts",
) -> Features:
    """Spin image of every point.

    Args:
        cloud: points and unit normals; P rows.
        near: the support of every point, with its ``radius``.
        width: W, the cells over alpha, and over each half of beta.
        support_cosine: in [0, 1], of the support angle: neighbors whose normal makes a larger angle with the point's
            own, up to sign, do not count. At 0 all count.
        structure: ``"rectangular"`` or ``"radial"`` coordinates.
        content: ``"counts"`` of neighbors, or mean ``"angles"`` between normals, in radians.

    Returns:
        Features of one block ("spin_images", (W + 1)(2 W + 1)): 153 numbers by default, beta moving fastest. A point
        without neighbors in the grid gets a zero row and is not valid. On the CPU the same bits for any chunking, batch
        and number of threads. With PCL's normals and neighborhoods the values are PCL's within rounding. Gradients of
        points and normals flow, of any order; the neighborhood and which neighbors count are held fixed.

    Raises:
        ValueError: no normals, neighborhoods of unknown radius, shapes that do not fit, numbers that are not finite, or
            an option out of its range.

    Example:
        >>> import torchreg as tr
        >>> cloud = tr.datasets.mall(seed=1, angular_step=3.0).source
        >>> near = tr.neighbors(cloud, 2.0, 60)
        >>> cloud = tr.estimate_normals(cloud, near)
        >>> tr.spin_images(cloud, near).values.shape[1]
        153
    """
    _expect_options(width, support_cosine, structure, content)
    normals = expect_oriented(cloud, near)
    points = cloud.points
    columns, nodes = [points, normals, support_radius(near, points)], (width + 1) * (2 * width + 1)

    def image(piece: Piece) -> Tensor:
        return _images(piece, width, support_cosine, structure == "radial", content == "angles")

    if len(points) > 0:
        values = by_rows(image, torch.cat(columns, dim=1), near, width=max(near.max_neighbors, nodes))
    else:
        values = points.new_empty(0, nodes)
    return Features(values, cloud.offsets, (("spin_images", nodes),), valid=largest_entries(values) != 0)


@checked_record
@dataclass(frozen=True, kw_only=True)
class SpinImages(Descriptor):
    """``torchreg.spin_images``: heights over the tangent plane and distances from the normal; 153 numbers.

    Attributes:
        width: cells over the distance, and over each half of the height.
        support_cosine: neighbors count whose normals' cosine with the point's own is not smaller; 0: all.
        structure: ``"rectangular"`` or ``"radial"``.
        content: ``"counts"`` or ``"angles"``.

    Example:
        >>> import torchreg as tr
        >>> options = tr.RegistrationOptions(descriptors=(tr.SpinImages(radius=0.3),), weights=(1.0,))
        >>> options.scaled(2.0).descriptors[0].radius
        0.6
    """

    name: ClassVar[str] = "spin_images"
    is_batched: ClassVar[bool] = True

    width: int = 8
    support_cosine: float = 0.0
    structure: str = "rectangular"
    content: str = "counts"

    def __post_init__(self) -> None:
        super().__post_init__()
        _expect_options(self.width, self.support_cosine, self.structure, self.content)

    @property
    def reach(self) -> float:
        """Meters: a point reads its neighbors alone."""
        return self.radius

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """As ``torchreg.spin_images``."""
        return spin_images(
            cloud,
            near,
            width=self.width,
            support_cosine=self.support_cosine,
            structure=self.structure,
            content=self.content,
        )

    def unsigned(self, values: Tensor) -> Tensor:
        """The image and its mirror image, which the sign of the normal exchanges, added."""
        image = values.view(len(values), self.width + 1, 2 * self.width + 1)
        return (image + image.flip(2)).view(values.shape)


def _expect_options(width: int, support_cosine: float, structure: str, content: str) -> None:
    at_least(width, "width", 1)
    expect(0 <= support_cosine <= 1, "support_cosine", "a number in [0, 1]", support_cosine)
    one_of(structure, "structure", STRUCTURES)
    one_of(content, "content", CONTENTS)


def _images(piece: Piece, width: int, support_cosine: float, radial: bool, of_angles: bool) -> Tensor:
    """Images (r, (W + 1)(2 W + 1)) of points whose columns are x, y, z, the normal and the radius."""
    px, py, pz, nx, ny, nz, radius = piece.query
    dx, dy, dz = piece.neighbor[0] - px, piece.neighbor[1] - py, piece.neighbor[2] - pz
    mx, my, mz = piece.neighbor[3:6]
    square = dx * dx + dy * dy + dz * dz
    cosine = nx * mx + ny * my + nz * mz
    counted = distinct(square) & (piece.votes != 0)
    if support_cosine > 0:
        counted = counted & (cosine.detach().abs() >= support_cosine)
    beta = nx * dx + ny * dy + nz * dz
    alpha = _root((dy * nz - dz * ny).square() + (dz * nx - dx * nz).square() + (dx * ny - dy * nx).square())
    if radial:
        # the point itself has no direction, and a normal of length zero none to compare with
        leaning = counted & distinct(alpha.square() + beta.square())
        beta = angle(torch.where(leaning, beta, 0), torch.where(leaning, alpha, 1)) * (2 / math.pi)
        alpha = _root(square) / radius
    else:
        half = radius * math.sqrt(0.5)
        alpha, beta = alpha / half, beta / half
        counted = counted & (alpha.detach() < 1) & (beta.detach().abs() < 1)
    shares = _node_shares(alpha, width), _node_shares(beta * 0.5 + 0.5, 2 * width)
    nodes = width + 1, 2 * width + 1
    votes = counted.to(square.dtype)
    counts = grid_votes(shares, votes, nodes)
    if of_angles:
        sine = _root((ny * mz - nz * my).square() + (nz * mx - nx * mz).square() + (nx * my - ny * mx).square())
        known = counted & distinct(sine.square() + cosine.square())
        turns = angle(torch.where(known, sine, 0), torch.where(known, cosine.abs(), 1))
        seen = counts.detach() > 0
        return torch.where(seen, grid_votes(shares, votes * turns, nodes) / torch.where(seen, counts, 1), 0)
    return counts / counted.sum(dim=1, keepdim=True).clamp(min=1)


def _node_shares(position: Tensor, cells: int) -> Shares:
    """The nodes at both ends of the cell of positions in [0, 1], and the share of the upper one."""
    place = position.clamp(0, 1) * cells
    lower = place.detach().floor().clamp(max=cells - 1)
    return Shares(lower.long(), lower.long() + 1, place - lower)


def _root(square: Tensor) -> Tensor:
    """Square roots whose gradient is zero at zero."""
    above = square.detach() > 0
    return torch.where(above, torch.where(above, square, 1).sqrt(), 0)
