"""The options of a registration, one line each."""

from __future__ import annotations

from collections.abc import Iterator

from torchreg.registration.options import RegistrationOptions
from torchreg.report.text import meters


def options_rows(options: RegistrationOptions, *, colored: bool) -> Iterator[tuple[str, str]]:
    """Name and value of what a user would ask about.

    Args:
        options: of one pair.
        colored: whether both clouds have colors; without, the color blocks take no part.
    """
    voxel = options.voxel_size
    yield "voxel size", "none: points as they are" if voxel is None else meters(voxel)
    yield "normals", f"within {meters(options.normal_radius)}, at most {options.normal_max_neighbors} neighbors"
    yield "FPFH", f"within {meters(options.feature_radius)}, at most {options.feature_max_neighbors} neighbors"
    if options.color and colored:
        blocks = " and ".join(
            f"{block} (weight {weight:g})" for block, weight in zip(options.color, options.color_weights, strict=True)
        )
        yield "color", f"{blocks} within {meters(options.color_radius)}"
    else:
        yield "color", "none: geometry alone"
    yield "inlier threshold", meters(options.ransac.inlier_threshold)
