"""Color-supported generalized ICP: neighbors by place and color, residuals between planes.

Korn, Holzkothen and Pauli, Color supported generalized-ICP, VISAPP 2014, doi:10.5220/0004692805920599. Correspondences
are the nearest in six dimensions, x, y, z and the weighted L, a, b of CIELAB; what is minimized is the distance between
planes of ``generalized``, as in PCL's ``GeneralizedIterativeClosestPoint6D``. So along a surface, where planes say
nothing, color decides which points belong together.

The paper and PCL multiply L, a, b by one number (PCL: 0.032), which suits clouds of one scale. Here black and white are
``color_scale`` meters apart, by default the largest distance of the level.
"""

from __future__ import annotations

from torchreg.refinement.color_axes import lab
from torchreg.refinement.estimator import Estimator, IcpKind
from torchreg.refinement.generalized import GENERALIZED, generalized
from torchreg.refinement.kernels import Kernel

_AXES = 6


def colored_generalized(kernel: Kernel) -> Estimator:
    """``generalized`` where partners are (x, y, z, L, a, b, normal)."""
    return generalized(kernel, normal=_AXES)


COLORED_GENERALIZED = IcpKind(
    needs=(("source", "colors"), ("target", "colors"), ("source", "normals"), ("target", "normals")),
    columns=GENERALIZED.columns,
    estimator=colored_generalized,
    beside=lab,
)
