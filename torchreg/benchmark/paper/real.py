"""Real scan pairs with known truth, listed in a folder's ``pairs.json``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchreg.datasets import ScanPair
from torchreg.errors import CloudFileError
from torchreg.io import read_cloud
from torchreg.io.transform_text import checked_rigid

LIST = "pairs.json"

_NEEDED = ("name", "source", "target", "T", "voxel_m", "colour", "difficulty")


@dataclass(frozen=True, eq=False, kw_only=True)
class RealPair:
    """One pair of the list.

    Attributes:
        name: different for every pair.
        source, target: the files.
        T_target_source: (4, 4) float64, meters.
        spacing: meters, to which the clouds are best thinned.
        outdoor: says the list.
    """

    name: str
    source: Path
    target: Path
    T_target_source: Tensor
    spacing: float
    outdoor: bool

    def read(self) -> ScanPair:
        """Both clouds; errors are those of ``read_cloud``."""
        return ScanPair(read_cloud(self.source), read_cloud(self.target), self.T_target_source, self.name)


def real_pairs(folder: Path) -> tuple[RealPair, ...]:
    """The pairs with colors on both sides and much overlap ("easy"), as two scans from one place have it.

    Args:
        folder: holds ``pairs.json``: under ``pairs`` a list of objects with ``name``, ``source`` and ``target`` (files
            beside it), ``T`` (4x4, meters), ``voxel_m``, ``colour``, ``difficulty`` and, where the scene lies in the
            open, the word "outdoor" in ``kind``.

    Raises:
        CloudFileError: no list, one that cannot be read, or one without such a pair; the message names the file.
    """
    path = folder / LIST
    try:
        listed = json.loads(path.read_text())["pairs"]
        chosen = [entry for entry in listed if all(entry[key] is not None for key in _NEEDED)]
        found = tuple(
            _pair(folder, entry) for entry in chosen if entry["colour"] is True and entry["difficulty"] == "easy"
        )
    except OSError as error:
        raise CloudFileError(f"{path}: expected a list of pairs, got {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise CloudFileError(f"{path}: expected a list of pairs with {', '.join(_NEEDED)}, got {error!r}") from None
    if not found:
        raise CloudFileError(f'{path}: expected a pair with colors and the difficulty "easy", got none')
    return found


def _pair(folder: Path, entry: dict[str, Any]) -> RealPair:
    return RealPair(
        name=str(entry["name"]),
        source=folder / entry["source"],
        target=folder / entry["target"],
        T_target_source=torch.from_numpy(checked_rigid(entry["T"], "T")),
        spacing=float(entry["voxel_m"]),
        outdoor="outdoor" in str(entry.get("kind", "")).lower(),
    )
