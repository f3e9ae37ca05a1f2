"""MAGSAC++: Barath et al., CVPR 2020, doi:10.1109/CVPR42600.2020.00138."""

from __future__ import annotations

from typing import Any

import numpy as np

from torchreg.benchmark.peers.method import Method
from torchreg.benchmark.peers.open3d_features import CONFIDENCE, HYPOTHESES, STATEMENT, MatchedRows, solved_by


def magsac(pairs: MatchedRows, threshold: float) -> Any:  # noqa: ANN401
    """The transform for row vectors (4, 4), or ``None``."""
    import pymagsac

    T, _ = pymagsac.findRigidTransformation(
        pairs, np.zeros(0), sampler=0, sigma_th=threshold, conf=CONFIDENCE, max_iters=HYPOTHESES
    )
    return T


METHODS = (
    Method(
        name="magsac",
        title="MAGSAC++",
        statement=STATEMENT,
        run=solved_by(magsac),
        module="pymagsac",
        package="pymagsac",
    ),
)
