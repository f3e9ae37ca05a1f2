"""Chooses what `register` does: the work per pair, other descriptors, another solver, the paper's procedure.

Options are records; those that `register` derives from the clouds are the place to begin.
"""

from dataclasses import replace

import torchreg as tr

hall = tr.datasets.mall(seed=1, baseline=2.0, angular_step=1.2)
options = tr.derive_options(hall.source, hall.target)[0]  # every length from the spacing of the points
radius = options.descriptors[0].radius
ways = {
    "default": options,
    "fast": replace(options, effort="fast"),
    "geometry alone": options.without_color(),
    "FPFH and contrast": replace(
        options, descriptors=(tr.Fpfh(radius=radius), tr.Contrast(radius=radius)), weights=(1.0, 0.8)
    ),
    "RANSAC": replace(options, solver=tr.RansacOptions(inlier_threshold=options.inlier_threshold)),
    "the paper's, smaller": replace(tr.PAPER.scaled(0.5), voxel_size=options.voxel_size),
}
for name, chosen in ways.items():
    result = tr.register(hall.source, hall.target, chosen)
    degrees = float(tr.metrics.rre(hall.T_target_source[None], result.T_target_source))
    print(f"{name:20} {bool(result.success)!s:5} {degrees:8.3f} degrees off  {result.reason[0]}")
