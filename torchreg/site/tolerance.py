"""When links agree: how far poses may be apart that are held to be one."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.errors import positive
from torchreg.site.graph import SiteGraph

_SIGMAS = 9.0  # squared: three deviations
_PER_LINK = 0.05  # of the tolerance, the error of one link that its covariance does not know of
_MOST = 2.0  # tolerances: a link that is known no better counts as known that well


@checked_record
@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """How far poses may be apart that are held to be one, besides what their covariances allow.

    Attributes:
        meters: between places.
        degrees: between directions.

    Example:
        >>> from torchreg.site import Tolerance
        >>> Tolerance(meters=0.1, degrees=2.0)
        Tolerance(meters=0.1, degrees=2.0)
    """

    meters: float = 0.3
    degrees: float = 3.0

    def __post_init__(self) -> None:
        positive(self.meters, "meters")
        positive(self.degrees, "degrees")

    def variances(self, graph: SiteGraph, scale: float = 1.0) -> tuple[Tensor, Tensor]:
        """The mean variances of turns (radians) and shifts (meters) of links, (L,), those promised times ``scale``."""
        diagonal = graph.covariance.diagonal(dim1=1, dim2=2)
        both = []
        for part, most in ((diagonal[:, :3], math.radians(self.degrees)), (diagonal[:, 3:], self.meters)):
            both.append((scale * part.mean(dim=1)).clamp(max=(_MOST * most) ** 2) + (_PER_LINK * most) ** 2)
        return both[0], both[1]

    def excess(self, turn: Tensor, shift: Tensor, turn_variance: Tensor, shift_variance: Tensor) -> Tensor:
        """How far turns (radians) and shifts (meters) go beyond what is allowed: at most 1 where they agree."""
        turns = turn.square() / (math.radians(self.degrees) ** 2 + _SIGMAS * turn_variance)
        shifts = shift.square() / (self.meters**2 + _SIGMAS * shift_variance)
        return turns.maximum(shifts)
