"""The title of a picture."""

from __future__ import annotations

import torch

from torchreg.report.text import chance, millimeters
from torchreg.types import RegistrationResult


def picture_title(names: str, result: RegistrationResult, pair: int = 0) -> str:
    """Names, verdict, probability and residual of a pair in one line, as far as they are known.

    Args:
        names: what the pair is called, such as "a.ply to b.ply".
        result: of B pairs.
        pair: which one.

    Example:
        >>> import torchreg as tr
        >>> scans = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> picture_title("a.ply to b.ply", tr.register(scans.source, scans.target))[:26]
        'a.ply to b.ply: registered'
    """
    failure = result.failure[pair]
    known = ["registered" if failure is None else f"not registered ({failure.kind})"]
    if result.probability is not None:
        known.append(f"probability {chance(float(result.probability[pair]))}")
    if result.residual_median is not None and bool(torch.isfinite(result.residual_median[pair])):
        known.append(f"residual {millimeters(float(result.residual_median[pair]))}")
    return f"{names}: {', '.join(known)}"
