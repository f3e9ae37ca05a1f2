"""What the columns of a text file are: by their names, or by what their numbers look like."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.io.checks import refuse, require
from torchreg.io.thin import CloudRows
from torchreg.io.units import METERS

XYZ, RGB, NORMAL = ("x", "y", "z"), ("red", "green", "blue"), ("nx", "ny", "nz")
SKIPPED = ("_", "-", "skip")
_UNIT = re.compile(r"[\[(]\s*([a-z-]+)\s*[\])]$")
_LETTERS = {"x": "x", "y": "y", "z": "z", "i": "intensity", "r": "red", "g": "green", "b": "blue", "_": "_"}
_NAMES = {
    **dict.fromkeys(("x", "easting", "east", "coordx", "x_coord", "x-coordinate"), "x"),
    **dict.fromkeys(("y", "northing", "north", "coordy", "y_coord", "y-coordinate"), "y"),
    **dict.fromkeys(("z", "height", "elevation", "elev", "coordz", "z_coord", "z-coordinate", "h"), "z"),
    **dict.fromkeys(("red", "r", "rf", "diffuse_red", "color_red", "colorr"), "red"),
    **dict.fromkeys(("green", "g", "gf", "diffuse_green", "color_green", "colorg"), "green"),
    **dict.fromkeys(("blue", "b", "bf", "diffuse_blue", "color_blue", "colorb"), "blue"),
    **dict.fromkeys(("nx", "normal_x", "normalx", "normal x"), "nx"),
    **dict.fromkeys(("ny", "normal_y", "normaly", "normal y"), "ny"),
    **dict.fromkeys(("nz", "normal_z", "normalz", "normal z"), "nz"),
    **dict.fromkeys(("intensity", "i", "reflectance", "reflectivity", "amplitude", "scalar_intensity"), "intensity"),
}
_UNIT_LENGTH = 0.02  # by which the length of a normal may differ from 1


@dataclass(frozen=True, kw_only=True)
class TextLayout:
    """The places of what a cloud has among the columns of a file, counted from 0.

    Attributes:
        places: by name: x, y, z, red, green, blue, nx, ny, nz, intensity.
        width: columns of a line; ``None`` where only those that are named are read.
        unit: of x, where its name says it.
        notes: what a user should know.
    """

    places: dict[str, int]
    width: int | None = None
    unit: str | None = None
    notes: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[int, ...]:
        """All places that are read."""
        return tuple(self.places.values())

    def rows(self, table: NDArray[Any]) -> CloudRows:
        """The parts of a cloud in the columns (n, len(self.columns)) that were read."""
        order = {name: k for k, name in enumerate(self.places)}

        def three(names: tuple[str, ...]) -> NDArray[Any] | None:
            return table[:, [order[name] for name in names]] if set(names) <= order.keys() else None

        intensity = table[:, order["intensity"]] if "intensity" in order else None
        return CloudRows(table[:, [order[name] for name in XYZ]], three(RGB), three(NORMAL), intensity)


def named_layout(path: Path, text: str) -> TextLayout:
    """The layout that a caller names: words such as "x y z _ red green blue", or letters such as "xyzirgb".

    Raises:
        CloudFileError: a name of no meaning or one that comes twice, or no x, y, z.
    """
    words = text.replace(",", " ").lower().split()
    if len(words) == 1 and set(words[0]) <= _LETTERS.keys():
        words = [_LETTERS[letter] for letter in words[0]]
    expected = "columns= of x, y, z, intensity, red, green, blue, nx, ny, nz, and _ for one to skip"
    places: dict[str, int] = {}
    for place, word in enumerate(words):
        if word in SKIPPED:
            continue
        name = _NAMES.get(word)
        if name is None or name in places:
            refuse(path, expected, repr(word) + (" twice" if name in places else ""))
        places[name] = place
    require(set(XYZ) <= places.keys(), path, expected, repr(text))
    return TextLayout(places=places)


def header_layout(words: list[str]) -> TextLayout | None:
    """The layout that the words of a header name; ``None`` where x, y and z are not among them."""
    places: dict[str, int] = {}
    unit = None
    for place, word in enumerate(words):
        plain = word.lower().strip().lstrip("/#%!").strip("\"' ")
        found = _UNIT.search(plain)
        name = _NAMES.get(_UNIT.sub("", plain).strip())
        if name is not None:
            places.setdefault(name, place)
        if name == "x" and found is not None and found[1] in METERS:
            unit = found[1]
    if not set(XYZ) <= places.keys():
        return None
    return TextLayout(places=_whole_groups(places), unit=unit)


def guessed_layout(path: Path, sample: NDArray[Any], *, intensity_first: bool) -> TextLayout:
    """The layout that the first lines of a file without a header look like; notes say what was taken.

    Args:
        path: the file.
        sample: (n, w) numbers of the first lines.
        intensity_first: whether the intensity comes before the colors where it may be either, as in PTS.

    Raises:
        CloudFileError: fewer than three columns.
    """
    width = sample.shape[1]
    require(width >= 3, path, "at least three numbers x y z in every line", f"{width}")
    names: tuple[str, ...] = XYZ
    if width == 4:
        names = (*XYZ, "intensity")
    elif width > 5:
        names = (*XYZ, *_tail(sample[:, 3:], intensity_first=intensity_first))
    places = {name: k for k, name in enumerate(names)}
    notes: tuple[str, ...] = ()
    if width > 3:
        unknown = f"; the other {width - len(names)} are not known" * (width > len(names))
        notes = (f"no header: columns are taken for {' '.join(names)}{unknown} (columns= names others)",)
    return TextLayout(places=places, width=width, notes=notes)


def _tail(rest: NDArray[Any], *, intensity_first: bool) -> tuple[str, ...]:
    """Names of the columns after x, y, z, at least three."""
    width = rest.shape[1]
    late = width >= 4 and _like_colors(rest[:, 1:4])
    if _like_normals(rest[:, :3]):
        return (*NORMAL, *(RGB if width >= 6 and _like_colors(rest[:, 3:6]) else ()))
    if _like_colors(rest[:, :3]) and not (intensity_first and late):
        if width >= 6 and _like_normals(rest[:, 3:6]):
            return (*RGB, *NORMAL)
        return (*RGB, *(("intensity",) if width == 4 else ()))
    if late:
        return ("intensity", *RGB, *(NORMAL if width >= 7 and _like_normals(rest[:, 4:7]) else ()))
    return ()


def _like_colors(three: NDArray[Any]) -> bool:
    """Whether columns (n, 3) are whole numbers from 0 to 255."""
    return bool(((three >= 0) & (three <= 255) & (three == np.floor(three))).all())


def _like_normals(three: NDArray[Any]) -> bool:
    """Whether columns (n, 3) are vectors of length one, but for a few zeros."""
    length = np.linalg.norm(three, axis=1)
    unit = np.abs(length - 1) < _UNIT_LENGTH
    return bool((unit | (length == 0)).all() and unit.mean() > 0.9)


def _whole_groups(places: dict[str, int]) -> dict[str, int]:
    """Places without those of colors or normals that are not complete."""
    broken = {name for group in (RGB, NORMAL) if not set(group) <= places.keys() for name in group}
    return {name: place for name, place in places.items() if name not in broken}
