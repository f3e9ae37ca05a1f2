"""How far a found transform is from the true one, as plain numbers."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.metrics import rmse, rre, rte
from torchreg.types import Clouds


class TruthErrors(NamedTuple):
    """The paper's Eq. (5) to (7).

    Attributes:
        rre_degrees: relative rotation error.
        rte_meters: relative translation error.
        rmse_meters: root mean square distance between the source points under the two transforms.
    """

    rre_degrees: float
    rte_meters: float
    rmse_meters: float


def truth_errors(source: Clouds, T_true: Tensor, T_estimated: Tensor) -> TruthErrors:
    """Compare two transforms (4, 4) of one cloud, origins included.

    Raises:
        ValueError: an empty cloud, or transforms of another shape.
    """
    points = source.points.detach().cpu().to(torch.float64) + source.origin.cpu()
    true, found = (T.detach().cpu().to(torch.float64) for T in (T_true, T_estimated))
    return TruthErrors(float(rre(true, found)), float(rte(true, found)), float(rmse(true, found, points)))
