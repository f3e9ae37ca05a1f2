"""Names of options from before descriptors were records, as changes of the records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from torchreg.arguments import expect_kind, kind_of
from torchreg.descriptors import DESCRIPTORS
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.descriptors.pcfh import Pcfh
from torchreg.errors import expect, one_of, positive

_FIELDS = {  # which records they change, and which field of these
    "feature_radius": ("geometry", "radius"),
    "feature_max_neighbors": ("any", "max_neighbors"),
    "color_radius": ("color", "radius"),
    "color_bins": ("pcfh", "bins"),
    "color_channels": ("pcfh", "channels"),
    "equalization": ("pcfh", "equalization"),
    "saturation_weighting": ("pcfh", "saturation_weighting"),
}
_DEFAULTS = {"geometry": Fpfh(radius=5.0), "any": Fpfh(radius=5.0), "color": Pcfh(radius=2.0), "pcfh": Pcfh(radius=2.0)}

_NOT_GIVEN: Any = object()
_NAMES = kind_of(Sequence[str])

Weighed = tuple[Descriptor, float]


def by_former_names(
    descriptors: tuple[Descriptor, ...], weights: tuple[float, ...], former: dict[str, Any]
) -> tuple[tuple[Descriptor, ...], tuple[float, ...]]:
    """Descriptors and weights with the values that are given under former names.

    Raises:
        ValueError: a value out of its range, even where no record reads it, or one length for records of several.
        TypeError: an unknown name.
    """
    former = dict(former)
    color, shares = former.pop("color", _NOT_GIVEN), former.pop("color_weights", _NOT_GIVEN)
    changes = {name: former.pop(name) for name in _FIELDS if name in former}
    if former:
        raise TypeError(f"RegistrationOptions has no option {next(iter(former))!r}")
    listed = list(zip(descriptors, weights, strict=True))
    if color is not _NOT_GIVEN:
        expect_kind(color, "color", _NAMES)
        listed = _with_color(listed, color)
    if shares is not _NOT_GIVEN:
        listed = _with_shares(listed, shares)
    for name, value in changes.items():
        listed = _changed(listed, name, value)
    return tuple(record for record, _ in listed), tuple(weight for _, weight in listed)


def _with_color(listed: list[Weighed], color: Sequence[str]) -> list[Weighed]:
    """The descriptors of geometry and the color descriptors of these names, kept where they are there."""
    left = [item for item in listed if item[0].needs_colors]
    if [record.name for record, _ in left] == list(color):
        return listed
    radius = (left or listed)[0][0].radius
    chosen = [item for item in listed if not item[0].needs_colors]
    for name in color:
        item = next((item for item in left if item[0].name == name), None)
        if item is None:
            one_of(name, "color", tuple(key for key, kind in DESCRIPTORS.items() if kind.needs_colors))
            item = (DESCRIPTORS[name](radius=radius), 1.0)
        else:
            left.remove(item)
        chosen.append(item)
    expect(len(chosen) > 0, "color", "at least one beside no descriptor of geometry", color)
    return chosen


def _with_shares(listed: list[Weighed], shares: Sequence[float]) -> list[Weighed]:
    count = sum(record.needs_colors for record, _ in listed)
    fits = isinstance(shares, Sequence) and len(shares) == count
    expect(fits, "color_weights", f"one per color block ({count})", shares)
    left = iter(shares)
    return [
        (record, positive(next(left), "color_weights") if record.needs_colors else weight) for record, weight in listed
    ]


def _changed(listed: list[Weighed], name: str, value: Any) -> list[Weighed]:  # noqa: ANN401
    kind, field = _FIELDS[name]

    def is_meant(record: Descriptor) -> bool:
        if kind == "pcfh":
            return isinstance(record, Pcfh)
        return kind == "any" or record.needs_colors == (kind == "color")

    meant = [record for record, _ in listed if is_meant(record)]
    lengths = {record.radius for record in meant} if field == "radius" else set()
    expect(len(lengths) <= 1, name, f"one support radius to change, not {len(lengths)}: name the records", value)
    try:
        replace(_DEFAULTS[kind], **{field: value})  # refuses what would be refused
        change = {field: value}
        return [(replace(record, **change) if is_meant(record) else record, weight) for record, weight in listed]
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name}:{str(error).partition(':')[2] or f' {error}'}") from None
