"""ICP in four dimensions: neighbors by place and hue, residuals between points.

Men, Gebre and Pochiraju, Color point cloud registration with 4D ICP algorithm, ICRA 2011,
doi:10.1109/ICRA.2011.5980407. Correspondences are the nearest by x, y, z and weighted hue, which light changes less
than brightness; the motion is that of point-to-point ICP.

Hue is circular: it enters as a point on a circle of diameter ``color_scale`` (meters; by default the largest distance
of the level), so that the difference counts by the chord. The paper's is linear in hue. Gray, which has no hue, lies in
the middle, as far from one hue as from another.
"""

from __future__ import annotations

from torchreg.refinement.color_axes import hue_circle
from torchreg.refinement.point_to_point import POINT_TO_POINT

HUE_POINT_TO_POINT = POINT_TO_POINT._replace(needs=(("source", "colors"), ("target", "colors")), beside=hue_circle)
