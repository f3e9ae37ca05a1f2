"""How large a run is: the paper's own sizes, or small ones to see within seconds that everything works."""

from __future__ import annotations

from typing import NamedTuple


class Size(NamedTuple):
    """What makes a run long or short.

    Attributes:
        angular_step: degrees between the rays of the simulated scanners.
        divisor: of the paper's point counts.
        hypotheses: that RANSAC draws at most.
        repeats: of every measured time.
        variants: whether stations apart are simulated too.
    """

    angular_step: float
    divisor: int
    hypotheses: int
    repeats: int
    variants: bool


FULL = Size(angular_step=0.4, divisor=1, hypotheses=600_000, repeats=7, variants=True)
QUICK = Size(angular_step=1.5, divisor=4, hypotheses=50_000, repeats=2, variants=False)
