"""What a file holds that reading it leaves behind, in words: who writes its points anew says so."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from torchreg.io.foreign import package, refusing
from torchreg.io.ply_header import read_header, vertices_of

_OF_E57 = ("cartesian", "spherical", "color", "nor:normal", "intensity", "isColorInvalid", "isIntensityInvalid")
_NAMED = 8  # of what is left out
_OF_PLY = {"x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"}


def unread_e57(path: Path) -> tuple[str, ...]:
    """Pictures, the coordinate system and further fields of an E57 file."""
    pye57 = package(path, "pye57", "pye57")
    with refusing(path, "an E57 file that pye57 reads"):
        file = pye57.E57(str(path))
        try:
            return tuple(_of_e57(file, pye57.libe57))
        finally:
            file.close()


def _of_e57(file: Any, libe57: Any) -> Iterator[str]:  # noqa: ANN401
    root = file.root
    pictures = root["images2D"].childCount() if root.isDefined("images2D") else 0
    if pictures:
        yield "pictures are left out"
    if root.isDefined("coordinateMetadata") and str(root["coordinateMetadata"].value()).strip():
        yield "the coordinate system is left out"
    names: dict[str, None] = {}
    for number in range(len(file.data3d)):
        prototype = libe57.StructureNode(file.data3d[number]["points"].prototype())
        names |= dict.fromkeys(prototype.get(k).elementName() for k in range(prototype.childCount()))
    others = [name for name in names if not name.startswith(_OF_E57)]
    if others:
        yield _left_out("field", others)


def unread_las(path: Path) -> tuple[str, ...]:
    """The coordinate system of a LAS file, and what its points have besides."""
    laspy = package(path, "laspy", "'laspy[lazrs]'")
    with refusing(path, "a LAS or LAZ file that laspy reads"), laspy.open(path) as file:
        records = [*file.header.vlrs, *(file.header.evlrs or ())]
    named = any("projection" in str(record.user_id).lower() for record in records)
    system = ("the coordinate system is left out",) * named
    return (*system, "classes, times and returns of points are left out")


def unread_ply(path: Path) -> tuple[str, ...]:
    """Properties of points and other elements of a PLY file."""
    header = read_header(path)
    place, _ = vertices_of(header, path)
    names = [one.name for one in header.elements[place].properties if one.name.lower() not in _OF_PLY]
    elements = [one.name for number, one in enumerate(header.elements) if number != place and one.rows]
    found = (("property", names), ("element", elements))
    return tuple(_left_out(what, those) for what, those in found if those)


def unread_ptx(path: Path) -> tuple[str, ...]:
    """The grid of a PTX file."""
    return ("the grid of columns and rows is left out",)


def _left_out(what: str, names: Sequence[str]) -> str:
    """Such as "left out, by property: red, alpha"."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"left out, by {what}: {', '.join(names[:_NAMED])}{more}"
