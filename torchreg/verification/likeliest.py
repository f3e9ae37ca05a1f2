"""The pose of a pair, trusted or not."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.types import RegistrationResult


def likeliest_pose(result: RegistrationResult, pair: int = 0) -> Tensor | None:
    """The transform of a pair that succeeded, the likeliest one of a pair that was refused.

    Args:
        result: of B pairs.
        pair: which one, from 0 to B - 1.

    Returns:
        ``T_target_source`` (4, 4) float64, meters, on the result's device; ``None`` where no pose was found at all,
        for which a result has the identity.
    """
    T = result.T_target_source[pair].detach()
    if bool(result.success[pair]):
        return T
    if result.candidates:
        return T if result.candidates[pair] else None
    return None if torch.equal(T, torch.eye(4, dtype=T.dtype, device=T.device)) else T
