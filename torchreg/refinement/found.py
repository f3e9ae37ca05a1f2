"""What a search for nearest points answers."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class FoundRows(NamedTuple):
    """The nearest points of Q queries."""

    rows: Tensor  # (Q, K), ascending by distance
    beyond: Tensor  # (Q,) meters: points that were not looked at are as far at least, and may be nearer than the last

    @classmethod
    def of_all(cls, rows: Tensor) -> FoundRows:
        """The rows (Q, K) of a search that no point escapes."""
        return cls(rows, torch.full((len(rows),), torch.inf, dtype=torch.float64, device=rows.device))
