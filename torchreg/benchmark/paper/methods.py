"""What is compared: FPFH alone, the paper's fusion, and the fusion without histogram equalization of hue."""

from __future__ import annotations

from dataclasses import replace

from torchreg.benchmark.paper.printed import FPFH, FUSED
from torchreg.descriptors.pcfh import Pcfh
from torchreg.registration import PAPER
from torchreg.registration.options import RegistrationOptions
from torchreg.solvers import RansacOptions

PLAIN_HUE = "FPFH + PCFH, hue not equalized"

METHODS = (FPFH, FUSED, PLAIN_HUE)
"""In the order of the tables' columns; the paper prints the first two."""

TITLES = {
    FPFH: "FPFH-based algorithm",
    FUSED: "Color-enhanced FPFH-based algorithm",
    PLAIN_HUE: "Color-enhanced, hue not equalized",
}

SHORT = {FPFH: "FPFH", FUSED: "FPFH + PCFH", PLAIN_HUE: "not equalized"}
"""For narrow columns."""


def options_of(
    method: str, *, scale: float = 1.0, hypotheses: int = 600_000, refit: bool = True
) -> RegistrationOptions:
    """The paper's parameters (section 4.1) for one method.

    Args:
        method: one of ``METHODS``.
        scale: of all lengths: 1 for the paper's, in meters.
        hypotheses: how many RANSAC draws at most.
        refit: ``False`` takes the hypothesis with the most inliers as it is, which may be what the paper did.
    """
    options = PAPER.scaled(scale)
    ransac = RansacOptions(hypotheses=hypotheses, inlier_threshold=options.inlier_threshold)
    options = replace(options, solver=ransac if refit else replace(ransac, local_optimization=0, scoring="count"))
    if method == FPFH:
        return options.without_color()
    if method == FUSED:
        return options
    geometry, color = options.descriptors
    return replace(options, descriptors=(geometry, Pcfh(radius=color.radius, equalization="none")))
