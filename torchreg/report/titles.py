"""The title of a picture."""

from __future__ import annotations

from torchreg.report.text import chance, meters
from torchreg.types import RegistrationResult


def picture_title(names: str, result: RegistrationResult, pair: int = 0, *, residual: float | None = None) -> str:
    """Names, verdict, probability and residual of a pair in one line, as far as they are known.

    Args:
        names: what the pair is called, such as "a.ply to b.ply".
        result: of B pairs.
        pair: which one.
        residual: how far surfaces lie apart under the transform, meters, where it was measured.

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
    if residual is not None:
        known.append(f"residual {meters(residual)}")
    return f"{names}: {', '.join(known)}"
