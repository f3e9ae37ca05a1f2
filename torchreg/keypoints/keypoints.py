"""A rule that selects keypoints as a record: what it needs of a cloud, and the function that selects rows.

To add a rule is to write such a record. ``register`` describes all points of a cloud on their whole neighborhoods and
matches those alone that the rule selects.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeVar

import torch
from torch import Tensor

from torchreg.types import Clouds, Neighborhoods
from torchreg.types.lengths import scaled
from torchreg.types.loading import loadable
from torchreg.types.packing import offsets_of, spans

AnyKeypoints = TypeVar("AnyKeypoints", bound="Keypoints")


class KeypointRows(NamedTuple):
    """Some of the points of a batch of clouds.

    ``cloud.rows(*selected)`` are the clouds of them, and ``KeypointFeatures(selected.rows, values[selected.rows])``
    their features for ``register_features``.

    Attributes:
        rows: (K,) int64, global rows of the packed batch, ascending, each once.
        offsets: (B+1,) int64, on the CPU: cloud ``b`` has the rows ``rows[offsets[b]:offsets[b+1]]``.

    Example:
        >>> import torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(100, 3))
        >>> selected = tr.uniform_keypoints(cloud, 0.5)
        >>> len(cloud.rows(*selected).points) == len(selected.rows)
        True
    """

    rows: Tensor
    offsets: Tensor


class KeypointSupport(NamedTuple):
    """The neighborhoods that a rule reads."""

    radius: float  # meters
    max_neighbors: int  # the nearest so many within it, the point itself counted
    reach: float  # meters: no point farther from another than this decides whether that one is selected


@dataclass(frozen=True, kw_only=True)
class Keypoints(ABC):
    """The options of one rule, and how it selects points of clouds. Subclasses are frozen dataclasses.

    Attributes:
        name: of the rule, in options and tables; one per class.

    Example:
        >>> import torchreg as tr
        >>> @dataclass(frozen=True, kw_only=True)
        ... class EverySecond(Keypoints):
        ...     name = "every second"
        ...
        ...     @classmethod
        ...     def for_spacing(cls, spacing):
        ...         return cls()
        ...
        ...     def select(self, cloud, near):
        ...         return rows_where(cloud, torch.arange(len(cloud.points)) % 2 == 0)
        >>> EverySecond().select(tr.Clouds(points=torch.rand(5, 3)), None).rows
        tensor([0, 2, 4])
    """

    name: ClassVar[str]

    def __init_subclass__(cls, **more: Any) -> None:  # noqa: ANN401
        """Let results that hold such a record be loaded by ``torch.load`` as they are."""
        super().__init_subclass__(**more)
        loadable(cls)

    @classmethod
    @abstractmethod
    def for_spacing(cls: type[AnyKeypoints], spacing: float) -> AnyKeypoints:
        """The rule for points ``spacing`` meters apart, as the command line takes it."""

    @property
    def support(self) -> KeypointSupport | None:
        """The neighborhoods that ``select`` reads; ``None`` where it reads none, and is asked about whole clouds."""
        return None

    def scaled(self: AnyKeypoints, factor: float) -> AnyKeypoints:
        """The same rule for points ``factor`` times as far apart: every length multiplied."""
        return scaled(self, factor)

    @abstractmethod
    def select(self, cloud: Clouds, near: Neighborhoods | None) -> KeypointRows:
        """Select points of every cloud.

        Args:
            cloud: one or several clouds, thinned, with unit normals; P rows.
            near: the neighborhoods that ``support`` asks for, of all P points; ``None`` where it asks for none.
        """


def rows_where(cloud: Clouds, chosen: Tensor) -> KeypointRows:
    """The rows of clouds where ``chosen`` (P,) bool is true."""
    counts = chosen.long().cumsum(0)
    upto = torch.cat([counts.new_zeros(1), counts])  # (P+1,), of which the host reads one number per cloud
    return KeypointRows(chosen.nonzero()[:, 0], upto[cloud.offsets.to(chosen.device)].cpu())


def rows_of_clouds(cloud: Clouds, rows: list[Tensor]) -> KeypointRows:
    """Join ascending rows of every cloud, counted from its first."""
    empty = torch.zeros(0, dtype=torch.int64, device=cloud.device)
    moved = [begin + each for (begin, _), each in zip(spans(cloud.offsets), rows, strict=True)]
    return KeypointRows(torch.cat([empty, *moved]), offsets_of(map(len, rows)))


def marked(rows: Tensor, count: int) -> Tensor:
    """(P,) bool, true at these rows of ``count``."""
    marks = torch.zeros(count, dtype=torch.bool, device=rows.device)
    marks[rows] = True
    return marks
