"""How many pairs go together, from one budget of memory."""

from __future__ import annotations

from collections.abc import Sequence

import psutil
import torch

from torchreg.errors import at_least
from torchreg.types import RegistrationOptions

SHARE = 0.25
"""Of the free memory, what a call takes where it is not told."""

_POINT_BYTES = 2000  # of a described point: itself, its descriptors, their copies in the slice and in its features
_PAIR_BYTES = 1 << 20  # of a pair whatever its size: hypotheses and candidates


def budget(max_bytes: int | None, device: torch.device) -> int:
    """The bytes that a call may work with.

    Args:
        max_bytes: what the caller says; ``None`` takes a quarter of what is free on the device now.
        device: where the clouds are.

    Raises:
        ValueError: ``max_bytes`` below 1.
    """
    if max_bytes is not None:
        return at_least(max_bytes, "max_bytes", 1)
    if device.type == "cuda":
        return int(SHARE * torch.cuda.mem_get_info(device)[0])
    return int(SHARE * psutil.virtual_memory().available)


def pair_bytes(points: int, options: RegistrationOptions) -> int:
    """About what a pair of this many points, both clouds together, holds while it is matched and solved."""
    return _PAIR_BYTES + points * _POINT_BYTES * (2 if options.effort == "thorough" else 1)


def slices(costs: Sequence[int], most: int) -> list[slice]:
    """Pairs in order, cut so that the costs of each slice sum to at most so much; one pair may cost more."""
    found: list[slice] = []
    begin = total = 0
    for place, cost in enumerate(costs):
        if place > begin and total + cost > most:
            found.append(slice(begin, place))
            begin, total = place, 0
        total += cost
    return [*found, slice(begin, len(costs))] if costs else found
