"""Real scan pairs with known truth, as a ``pairs.json`` lists them."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchreg.errors import CloudFileError
from torchreg.io.transform_text import checked_rigid

LIST = "pairs.json"

_NEEDED = ("name", "scene", "source", "target", "T", "voxel_m", "overlap")


@dataclass(frozen=True, eq=False, kw_only=True)
class RealPair:
    """One pair of the list."""

    name: str  # different for every pair
    scene: str  # where it was scanned
    source: Path  # the file of the source cloud
    target: Path  # the file of the target cloud
    T_target_source: Tensor  # (4, 4) float64, meters, true
    voxel: float  # meters, the voxels to average both clouds over
    overlap: float  # share of either cloud that the other covers
    colored: bool = True  # whether the clouds have colors, by the list
    outdoor: bool = False  # whether the scene is outdoors, by the list


def read_real_pairs(path: str | os.PathLike[str]) -> tuple[RealPair, ...]:
    """Read a list of pairs.

    Args:
        path: the list, or a folder with a ``pairs.json``: under ``pairs`` objects with ``name``, ``scene``, ``source``
            and ``target`` (files beside the list), ``T`` (4x4, maps source points into the target's frame, meters),
            ``voxel_m`` and ``overlap``; optional are ``colour`` (true unless given) and ``kind`` (outdoors where it has
            the word "outdoor"); others are not read.

    Raises:
        CloudFileError: no list, one that cannot be read, or one without pairs; the message names the file.
    """
    file = Path(path) / LIST if Path(path).is_dir() else Path(path)
    expected = f"{file}: expected a list of pairs with {', '.join(_NEEDED)}"
    try:
        pairs = tuple(_pair(file.parent, entry) for entry in json.loads(file.read_text())["pairs"])
    except OSError as error:
        raise CloudFileError(f"{expected}, got {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise CloudFileError(f"{expected}, got {error!r}") from None
    names = [pair.name for pair in pairs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise CloudFileError(f"{file}: expected a different name for every pair, got {twice!r} twice")
    if not pairs:
        raise CloudFileError(f"{expected}, got none")
    return pairs


def _pair(folder: Path, entry: dict[str, Any]) -> RealPair:
    return RealPair(
        name=str(entry["name"]),
        scene=str(entry["scene"]),
        source=folder / entry["source"],
        target=folder / entry["target"],
        T_target_source=torch.from_numpy(checked_rigid(entry["T"], "T")),
        voxel=float(entry["voxel_m"]),
        overlap=float(entry["overlap"]),
        colored=bool(entry.get("colour", True)),
        outdoor="outdoor" in str(entry.get("kind", "")).lower(),
    )
