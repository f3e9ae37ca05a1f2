"""Clouds in different units of length, told by figures of the two before anything is matched.

The ratio of extents alone says nothing: a patch is small beside a map. Nor does the ratio of spacings: a thinned cloud
has wide ones. Clouds of one place in two units differ in both by the same factor.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.types import Clouds, Failure

_UNITS = {
    1000.0: "millimeters beside meters",
    304.8: "millimeters beside feet",
    100.0: "centimeters beside meters",
    39.37: "inches beside meters",
    25.4: "millimeters beside inches",
}
"""How many times as large a cloud looks in the one unit, read as if it were the other."""

_FEET = 3.2808  # to a meter
_TOLERANCE = 2.0  # by which either ratio may miss a factor: clouds of one place differ in extent and density
_NEAR = 1.25  # likewise for feet, which mixed densities come close to
_FAR_APART = 1000.0  # extents that no two clouds of one place have
_SPACINGS = 20.0  # of the larger cloud that the smaller one spans at most: no setting registers so few

_NEIGHBOR = 4
_QUERIES = 24


class Lengths(NamedTuple):
    """Of one cloud, in meters as it is read: the longest edge of its bounding box, and the spacing of its points."""

    extent: float
    spacing: float


def rough_spacing(cloud: Clouds) -> float:
    """The median distance, meters, of 24 points of one cloud to their fourth nearest other ones; 0 of fewer than 5.

    To some 15 %. The points are an even choice.
    """
    count = len(cloud.points)
    if count <= _NEIGHBOR:
        return 0.0
    columns = cloud.points.t().contiguous()
    chosen = torch.arange(min(count, _QUERIES), device=cloud.device) * count // min(count, _QUERIES)
    distances = []
    for rows in row_chunks(len(chosen), count):
        square = columns.new_zeros(rows.stop - rows.start, count)
        for axis in columns:
            apart = axis[chosen[rows], None] - axis
            square.addcmul_(apart, apart)
        distances.append(square.topk(_NEIGHBOR + 1, dim=1, largest=False).values.amax(dim=1))
    return float(torch.cat(distances).median().sqrt())


def units_failure(source: Lengths, target: Lengths) -> Failure | None:
    """Why two clouds are taken to be in different units; ``None`` where nothing speaks for it.

    Both ratios lie near one factor, and the smaller cloud spans hardly more than some spacings of the larger one, so
    that a pair which is as it should be is not lost by the refusal.
    """
    (extent, spacing), names, (large, small) = _ratios(source, target)
    near = [unit for unit in _UNITS if max(_off(extent, unit), _off(spacing, unit)) <= _TOLERANCE]
    if not near or small.extent >= _SPACINGS * large.spacing:
        return None
    unit = min(near, key=lambda factor: _off((extent * spacing) ** 0.5, factor))
    figures = {"extent_ratio": extent, "spacing_ratio": spacing, "factor": unit}
    factor = f"{unit:,.0f}" if unit >= 100 else f"{unit:.3g}"
    lengths = (
        f"extents {large.extent:.3g} and {small.extent:.3g} m, spacings {large.spacing:.2g} and {small.spacing:.2g} m"
    )
    text = f"units: the {names[0]} is about {factor} times as large as the {names[1]} ({lengths}): {_UNITS[unit]}?"
    return Failure("units", text, figures)


def feet_note(source: Lengths, target: Lengths) -> str:
    """A remark where the clouds may be in feet and meters, else empty; clouds of two densities may look the same."""
    (extent, spacing), names, _ = _ratios(source, target)
    if max(_off(extent, _FEET), _off(spacing, _FEET)) > _NEAR:
        return ""
    return (
        f"the {names[0]} is about {extent:.2g} times as large as the {names[1]}, and its points lie about "
        f"{spacing:.2g} times as far apart: feet beside meters?"
    )


def extents_note(source: Lengths, target: Lengths) -> str:
    """A remark where one cloud spans a thousand times as much as the other, else empty."""
    (ratio, _), names, sides = _ratios(source, target)
    if ratio < _FAR_APART:
        return ""
    extents = f"{sides[0].extent:.3g} m beside {sides[1].extent:.3g} m"
    return (
        f"the {names[0]} spans {ratio:.3g} times as much as the {names[1]}, {extents}: another unit, or points far off?"
    )


def _ratios(source: Lengths, target: Lengths) -> tuple[Lengths, tuple[str, str], tuple[Lengths, Lengths]]:
    """Extent and spacing of the larger cloud over those of the smaller, their roles, and both; ratios of 0 unknown."""
    names, sides = ("source", "target"), (source, target)
    if target.extent > source.extent:
        names, sides = ("target", "source"), (target, source)
    large, small = sides
    known = min(*large, *small) > 0
    ratios = Lengths(large.extent / small.extent, large.spacing / small.spacing) if known else Lengths(0.0, 0.0)
    return ratios, names, sides


def _off(ratio: float, factor: float) -> float:
    """By which factor, at least 1, a ratio misses another."""
    return max(ratio / factor, factor / ratio) if ratio > 0 else float("inf")
