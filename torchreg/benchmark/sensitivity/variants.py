"""One choice varied at a time, around the paper's rule."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A color block beside FPFH. The defaults are the paper's: 11 bins of hue, equalized per cloud, equal weight.

    Attributes:
        bins: of every histogram.
        radius: in voxels (the paper: 2 m where FPFH has 5 m).
        weight: of the color block beside FPFH's 1; 0 leaves color out.
        equalization: of hue, ``"none"``, ``"cloud"`` or ``"joint"``.
        saturation_weighting: whether votes on hue count by both saturations.
        channels: which are compared.
        root: how far the entries of both histograms are moved towards their square roots.
    """

    bins: int = 11
    radius: float = 2.0
    weight: float = 1.0
    equalization: str = "cloud"
    saturation_weighting: bool = False
    channels: tuple[str, ...] = ("hue",)
    root: float = 0.0


PAPER_RULE = Variant()

BETTER_RULE = Variant(equalization="none", channels=("hue", "saturation", "value"))
"""What a first sweep around the paper's rule found better one by one, swept around in turn."""

AXES: dict[str, tuple[object, ...]] = {
    "bins": (3, 5, 8, 11, 16, 22, 33),
    "radius": (1.0, 1.5, 2.0, 3.0, 4.0, 5.0),
    "weight": (0.0, 0.25, 0.5, 1.0, 2.0, 4.0),
    "equalization": ("none", "cloud", "joint"),
    "saturation_weighting": (False, True),
    "root": (0.0, 0.5, 1.0),
    "channels": (
        ("hue",),
        ("saturation",),
        ("value",),
        ("hue", "saturation"),
        ("hue", "value"),
        ("saturation", "value"),
        ("hue", "saturation", "value"),
    ),
}


def around(center: Variant) -> dict[str, list[Variant]]:
    """For every axis the variants that differ from ``center`` there alone, the center among them."""
    return {axis: [replace(center, **{axis: value}) for value in values] for axis, values in AXES.items()}  # type: ignore[arg-type]


def label(value: object) -> str:
    """A value of an axis as tables print it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return " + ".join(value)
    return f"{value:g}" if isinstance(value, float) else str(value)
