"""Why a pair was not registered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from torchreg.errors import one_of
from torchreg.types.loading import loadable

KINDS = (
    # of the clouds
    "too few points",
    "not finite",
    "too wide",
    "degenerate",
    "units",
    # of the matches
    "too few matches",
    "no hypothesis",
    "no consensus",
    "mirrored",
    "scaled",
    # of the best pose
    "ambiguous",
    "sliding",
    "little overlap",
    "surfaces disagree",
    "colors disagree",
    "free-space conflict",
)
"""The kinds of failure, in the order of the stages that detect them."""

KINDS_OF_GIVEN = ("displaced", "another pose is better")
"""The further kinds that only a given transform has."""

KINDS_OF_ICP = ("not rigid", "no correspondences", "motion open", "not converged")
"""The further kinds of transforms that ICP could not refine."""


@loadable
@dataclass(frozen=True)
class Failure:
    """Why one pair did not succeed.

    Attributes:
        kind: one of ``KINDS``, ``KINDS_OF_GIVEN`` or ``KINDS_OF_ICP``, for programs to act on.
        text: for people, the kind and the figures in one sentence.
        figures: the numbers that decided it by name, such as ``{"matches": 2, "needed": 3}``; lengths in meters.

    Raises:
        ValueError: an unknown kind.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> result = tr.register(tr.random_downsample(pair.source, 3), pair.target)
        >>> result.failure[0].kind
        'too few points'
    """

    kind: str
    text: str
    figures: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        one_of(self.kind, "kind", KINDS + KINDS_OF_GIVEN + KINDS_OF_ICP)

    def __str__(self) -> str:
        return self.text
