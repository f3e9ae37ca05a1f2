"""A descriptor as a record: what it needs of a cloud, and the function that describes one.

To add a descriptor is to write such a record. Everything that ``register`` needs follows from it: how far neighbors
are searched, which clouds share a description, which descriptors are left where clouds have no colors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.errors import at_least, positive
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.lengths import length, scaled
from torchreg.types.loading import loadable

AnyDescriptor = TypeVar("AnyDescriptor", bound="Descriptor")


def largest_entries(values: Tensor) -> Tensor:
    """The largest magnitude (P,) in every row of features (P, D), NaN in rows that hold one, zero in zero rows."""
    return values.detach().abs().amax(dim=1) if values.shape[1] > 0 else values.new_zeros(values.shape[0])


def support_radius(near: Neighborhoods, like: Tensor) -> Tensor:
    """The radius of every neighborhood (P, 1), in the dtype and on the device of ``like``; ``ValueError`` for none."""
    if near.radius is None:
        raise ValueError("near: expected neighborhoods whose radius is known, got None")
    if isinstance(near.radius, Tensor):
        return near.radius.to(like)[:, None]
    return like.new_full((len(near), 1), near.radius)


@checked_record
@dataclass(frozen=True, kw_only=True)
class Descriptor(ABC):
    """The options of one descriptor, and how it describes a cloud. Subclasses are frozen dataclasses.

    Attributes:
        radius: meters, the support radius: neighbors nearer than this are described.
        max_neighbors: the nearest so many of them, the point itself counted.
        name: of the block of its features, such as ``"fpfh"``; one per class.
        needs_colors: whether it is left out for clouds without colors.
        is_histogram: whether its entries are percents not below 0, which ``RegistrationOptions.root`` moves towards
            their square roots.
        is_batched: whether ``describe`` reads no length of the record: ``near.radius`` in place of ``self.radius``.
            Clouds of several scales are then described in one call, else one by one.

    Raises:
        ValueError: a radius that is not above 0, or fewer than 2 neighbors.

    Example:
        >>> import torch
        >>> @dataclass(frozen=True, kw_only=True)
        ... class Density(Descriptor):
        ...     name = "density"
        ...
        ...     def describe(self, cloud, near):
        ...         count = near.valid.sum(dim=1, keepdim=True).to(cloud.points)
        ...         return Features(count, cloud.offsets, ((self.name, 1),), valid=count[:, 0] > 1)
        >>> Density(radius=0.25).scaled(2).radius
        0.5
    """

    name: ClassVar[str]
    needs_colors: ClassVar[bool] = False
    is_histogram: ClassVar[bool] = False
    is_batched: ClassVar[bool] = False

    radius: float = length()
    max_neighbors: int = 100

    def __init_subclass__(cls, **more: Any) -> None:  # noqa: ANN401
        """Let results that hold such a record be loaded by ``torch.load`` as they are."""
        super().__init_subclass__(**more)
        loadable(cls)

    def __post_init__(self) -> None:
        positive(self.radius, "radius")
        at_least(self.max_neighbors, "max_neighbors", 2)

    @property
    def is_pairwise(self) -> bool:
        """Whether a description depends on the other cloud of the pair: ``describe`` then gets both clouds."""
        return False

    @property
    def reach(self) -> float | None:
        """Meters: no point farther from another than this changes its row; ``None`` where any point may.

        Large clouds whose descriptors all state it are described in tiles, within the memory that is granted.
        """
        return None

    def scaled(self: AnyDescriptor, factor: float) -> AnyDescriptor:
        """The same descriptor for points ``factor`` times as far apart: every length multiplied."""
        return scaled(self, factor)

    def unsigned(self, values: Tensor) -> Tensor:
        """What of features (P, D) does not depend on the common sign of all normals; all of it by default."""
        return values

    @abstractmethod
    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """Describe every point.

        Args:
            cloud: one or several clouds, thinned, with unit normals, and with colors where ``needs_colors``; P rows.
            near: the support of every point: neighbors within the radius, at most ``max_neighbors``, the point itself
                among them; ``near.radius`` is that radius in meters, a number or (P,).

        Returns:
            Features (P, D) on the device and in the dtype of the points. A row that describes nothing is zero and
            not valid.
        """
