"""Graph-Cut RANSAC: Barath and Matas, CVPR 2018, doi:10.1109/CVPR.2018.00704."""

from __future__ import annotations

from typing import Any

import numpy as np

from torchreg.benchmark.peers.method import Method
from torchreg.benchmark.peers.open3d_features import CONFIDENCE, HYPOTHESES, STATEMENT, MatchedRows, solved_by


def graph_cut_ransac(pairs: MatchedRows, threshold: float) -> Any:  # noqa: ANN401
    """The transform for row vectors (4, 4), or ``None``."""
    import pygcransac

    # space partitioning, which its default is, takes neighborhood 0 alone
    T, _ = pygcransac.findRigidTransform(
        pairs, np.zeros(0), threshold, conf=CONFIDENCE, max_iters=HYPOTHESES, neighborhood=0, sampler=0
    )
    return T


METHODS = (
    Method(
        name="gc-ransac",
        title="Graph-Cut RANSAC",
        statement=STATEMENT,
        run=solved_by(graph_cut_ransac),
        module="pygcransac",
        package="pygcransac",
    ),
)
