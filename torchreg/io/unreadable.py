"""Files that are not read, and what to do with each: formats of one maker, drawings, meshes, rasters, archives."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NoReturn

from torchreg.io.checks import refuse

_SCANNER = "export the scans from its maker's program as E57"
_MESH = "a mesh: sample points on it and save them as PLY (CloudCompare: Edit > Mesh > Sample points)"
_DRAWING = "a drawing: export its point cloud from the program as E57 or LAS"
_PACKED = "an archive: unpack it and name the cloud in it"

ADVICE = {
    **dict.fromkeys((".rcp", ".rcs"), "Autodesk ReCap's own: export it from there as E57"),
    **dict.fromkeys((".fls", ".fws", ".lsproj"), f"FARO's own: {_SCANNER}"),
    **dict.fromkeys((".zfs", ".zfprj"), f"Zoller + Froehlich's own: {_SCANNER}"),
    **dict.fromkeys((".rdb", ".rdbx", ".rxp", ".3dd"), f"RIEGL's own: {_SCANNER}"),
    **dict.fromkeys((".imp", ".lgs", ".lgsx"), f"Leica's own: {_SCANNER}"),
    **dict.fromkeys((".tzf", ".tzs"), f"Trimble's own: {_SCANNER}"),
    **dict.fromkeys((".clr", ".cl3"), f"Topcon's own: {_SCANNER}"),
    ".pod": "Bentley Pointools' own: export it from there as E57 or LAS",
    ".bin": "CloudCompare's own: save the cloud there as E57, LAS or PLY",
    ".potree": "cut up for a viewer: use the file it was made from, or convert it to LAZ",
    **dict.fromkeys((".octree", ".ept", ".pnts", ".3tz"), "cut up for a viewer: use the file it was made from"),
    **dict.fromkeys((".dwg", ".dxf", ".dgn", ".3dm", ".rvt", ".ifc"), _DRAWING),
    **dict.fromkeys((".obj", ".stl", ".off", ".gltf", ".glb", ".fbx", ".3ds", ".dae", ".skp", ".usdz"), _MESH),
    **dict.fromkeys((".splat", ".spz", ".ksplat"), "Gaussian splats, packed: export them as PLY"),
    **dict.fromkeys((".bag", ".mcap", ".db3", ".pcap"), "a recording: export single scans from it as PCD or PLY"),
    **dict.fromkeys((".tif", ".tiff", ".dem"), "a raster: export its points as LAS or as text"),
    **dict.fromkeys((".zip", ".gz", ".7z", ".rar", ".tar", ".xz", ".bz2", ".zst"), _PACKED),
}
"""What to do with a file of this suffix; readers of ``formats`` come first."""


def refuse_suffix(path: Path, readable: Iterable[str]) -> NoReturn:
    """Raise ``CloudFileError`` for a file that no reader takes, with advice where its format is known.

    Args:
        path: the file.
        readable: suffixes that are read.
    """
    suffix = path.suffix
    advice = ADVICE.get(suffix.lower())
    received = repr(suffix) if advice is None else f"{suffix!r} ({advice})"
    refuse(path, "a name that ends in " + ", ".join(readable), received)
