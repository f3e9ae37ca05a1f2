"""The origin that is taken off the points, and the position of the scanner."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import expect
from torchreg.types import Clouds

FARTHEST_COORDINATE = 1e12  # meters; beyond it the bytes are no coordinates
FAR_COORDINATE = 1000.0  # meters; float32 keeps 0.03 mm at this distance from zero
FAR_VIEWPOINT = 10.0  # diagonals of the bounding box between it and the frame's origin

Viewpoint = str | Sequence[float] | Tensor | None


class Scanner(NamedTuple):
    """A scanner's position (3,) float64, or ``None``, where that comes from, and whether it is only a guess."""

    position: NDArray[Any] | None
    source: str
    assumed: bool = False


def choose_origin(points: NDArray[Any]) -> NDArray[Any]:
    """The origin (3,) to take off points (N, 3) float64, in meters.

    Zero where the median point lies within 1 km of zero on every axis, so that ordinary scans keep their
    coordinates; else the median point, rounded to whole meters. A few wild points do not move a median.
    """
    center = np.round(np.median(points, axis=0))
    return center if np.abs(center).max() > FAR_COORDINATE else np.zeros(3)


def checked_viewpoint(viewpoint: Viewpoint) -> str | NDArray[Any] | None:
    """Return "auto", "origin", ``None`` or a position (3,) float64.

    Raises:
        ValueError: anything else.
    """
    if viewpoint is None or (isinstance(viewpoint, str) and viewpoint in ("auto", "origin")):
        return viewpoint
    expected = "'auto', 'origin', None or three finite numbers"
    try:
        position = np.asarray(viewpoint, dtype=np.float64)
    except (TypeError, ValueError):
        position = np.zeros(0)
    expect(position.shape == (3,) and bool(np.isfinite(position).all()), "viewpoint", expected, viewpoint)
    return position


def place_scanner(
    wanted: str | NDArray[Any] | None, in_file: Scanner | None, points: NDArray[Any], origin: NDArray[Any]
) -> Scanner:
    """Decide on the viewpoint.

    "auto" takes what the file says; else it assumes the zero of the file's frame, where a terrestrial scanner
    stands, unless the points' bounding box is more than ten of its diagonals away from it, as with UTM coordinates.

    Args:
        wanted: a ``checked_viewpoint``; a position is meant in the file's frame.
        in_file: what the file says, relative to ``origin``; ``None`` where it says nothing.
        points: (N, 3) relative to ``origin``, finite.
        origin: (3,) in the file's frame.

    Returns:
        The position relative to ``origin``.
    """
    if wanted is None:
        return Scanner(None, "none, as asked for")
    if not isinstance(wanted, str):
        return Scanner(wanted - origin, "given by the caller")
    if wanted == "origin":
        return Scanner(-origin, "the origin of the file's frame, as asked for")
    if in_file is not None:
        return in_file
    low, high = points.min(axis=0), points.max(axis=0)
    outside = np.maximum(np.maximum(low + origin, -(high + origin)), 0)  # (3,), from zero to the box
    distance, diagonal = float(np.linalg.norm(outside)), float(np.linalg.norm(high - low))
    if distance > FAR_VIEWPOINT * diagonal:
        source = f"none: the frame's origin is {distance:.0f} m from points that span {diagonal:.1f} m"
        return Scanner(None, source)
    return Scanner(-origin, "the origin of the file's frame, assumed", assumed=True)


def scanner_of_file(position: NDArray[Any], *, assumed: bool) -> Scanner:
    """What a file says of its scanner: a position (3,), NaN where that is not known, and whether it is a guess.

    A position where no coordinate can be is none.
    """
    if not np.isfinite(position).all():
        return Scanner(None, "none: not known, as the file says")
    farthest = float(np.abs(position).max())
    if farthest > FARTHEST_COORDINATE:
        return Scanner(None, f"none: the file's lies {farthest:.3g} m away")
    return Scanner(position, "assumed, as the file says" if assumed else "the file", assumed)


def viewpoint_of_text(text: str, name: str = "viewpoint") -> str | tuple[float, ...] | None:
    """The ``viewpoint`` of ``read_cloud`` that a text means: ``auto``, ``origin``, ``none`` or ``x,y,z`` in meters.

    Raises:
        ValueError: anything else; the message calls it by ``name``.
    """
    if text in ("auto", "origin"):
        return text
    if text == "none":
        return None
    try:
        position = tuple(float(word) for word in text.split(","))
    except ValueError:
        position = ()
    expect(len(position) == 3, name, "auto, origin, none or three numbers x,y,z in meters", text)
    return position


def viewpoint_or_nan(cloud: Clouds) -> Tensor:
    """The viewpoint (3,) of one cloud as files hold it: relative to the origin; NaN where it is not known."""
    return cloud.points.new_full((3,), float("nan")) if cloud.viewpoint is None else cloud.viewpoint[0]
