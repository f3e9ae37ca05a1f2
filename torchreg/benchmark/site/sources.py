"""Where sites come from: simulated buildings, folders with a ``site.json``, and the pairs of a ``pairs.json``."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch

from torchreg.benchmark.core.real_pairs import LIST, RealPair, read_real_pairs
from torchreg.benchmark.site.true_site import KnownPair, Readings, TrueSite, known_pairs
from torchreg.errors import CloudFileError, expect
from torchreg.io import read_cloud
from torchreg.io.transform_text import checked_rigid
from torchreg.preprocess import voxel_downsample

SITE = "site.json"
_BUILDING_VOXEL = 0.1  # meters

_NEEDED = ("voxel_m", "scans", "file", "T_world_scan")


def simulated_sites(
    seeds: Sequence[int], scans: Sequence[int], *, floors: int = 3, angular_step: float = 1.4
) -> list[TrueSite]:
    """A building for every number of scans, up to 500, and every seed.

    Raises:
        ValueError: a number of scans that no building can have.
    """
    for count in scans:
        expect(5 <= count <= 500, "scans", "from 5 to 500", count)
    return [
        TrueSite(
            name=f"building-{seed}-of-{count}",
            family=f"buildings of {count} scans, {floors} floor{'s' * (floors > 1)}",
            scans=count,
            voxel=_BUILDING_VOXEL,
            read=partial(_simulated, seed, count, floors, angular_step),
        )
        for count in scans
        for seed in seeds
    ]


def read_sites(path: str | os.PathLike[str]) -> list[TrueSite]:
    """The real sites of a path; clouds are read later, and averaged over the voxels of their site.

    Args:
        path: a folder with a ``site.json``, or one of such folders: ``voxel_m``, and under ``scans`` objects with
            ``file`` (beside it) and ``T_world_scan`` (4x4, meters). Or a ``pairs.json``, or its folder, as ``bench
            field`` takes it: the clouds of all pairs of a scene are a site, of which the poses of these pairs are
            known.

    Raises:
        CloudFileError: nothing of these, or a list that cannot be read; the message names the file.
    """
    folder = Path(path)
    if folder.is_file() or (folder / LIST).is_file():
        return _scenes(read_real_pairs(folder))
    files = [folder / SITE] if (folder / SITE).is_file() else sorted(folder.glob(f"*/{SITE}"))
    if not files:
        raise CloudFileError(f"{folder}: expected {SITE}, folders with one, or {LIST}, got none of them")
    return [_listed(file) for file in files]


def _simulated(seed: int, count: int, floors: int, angular_step: float) -> Readings:
    from torchreg.synthetic import building

    site = building(seed, scans=count, floors=floors, angular_step=angular_step)
    return Readings(site.scans, known_pairs(site.T_world_scan), site.T_world_scan)


def _listed(file: Path) -> TrueSite:
    expected = f"{file}: expected a site with {', '.join(_NEEDED)}"
    try:
        content = json.loads(file.read_text())
        voxel, scans = float(content["voxel_m"]), [_scan(file.parent, entry) for entry in content["scans"]]
    except OSError as error:
        raise CloudFileError(f"{expected}, got {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise CloudFileError(f"{expected}, got {error!r}") from None
    if len(scans) < 2:
        raise CloudFileError(f"{expected}, of two scans or more, got {len(scans)}")
    name = file.parent.absolute().name
    return TrueSite(name=name, family="real sites", scans=len(scans), voxel=voxel, read=partial(_read, scans, voxel))


def _scan(folder: Path, entry: dict[str, Any]) -> tuple[Path, torch.Tensor]:
    return folder / entry["file"], torch.from_numpy(checked_rigid(entry["T_world_scan"], "T_world_scan"))


def _read(scans: Sequence[tuple[Path, torch.Tensor]], voxel: float) -> Readings:
    T_world_scan = torch.stack([T for _, T in scans])
    clouds = tuple(voxel_downsample(read_cloud(file), voxel) for file, _ in scans)
    return Readings(clouds, known_pairs(T_world_scan), T_world_scan)


def _scenes(pairs: Sequence[RealPair]) -> list[TrueSite]:
    """A site of every scene of three clouds or more."""
    scenes: dict[str, list[RealPair]] = {}
    for pair in pairs:
        scenes.setdefault(pair.scene, []).append(pair)
    sites = []
    for scene, listed in scenes.items():
        files = sorted({file for pair in listed for file in (pair.source, pair.target)})
        if len(files) > 2:
            voxel = max(pair.voxel for pair in listed)
            read = partial(_read_scene, files, listed, voxel)
            sites.append(TrueSite(name=scene, family="scenes of pairs", scans=len(files), voxel=voxel, read=read))
    return sites


def _read_scene(files: Sequence[Path], listed: Sequence[RealPair], voxel: float) -> Readings:
    number = {file: k for k, file in enumerate(files)}
    known = tuple(KnownPair(number[pair.source], number[pair.target], pair.T_target_source) for pair in listed)
    return Readings(tuple(voxel_downsample(read_cloud(file), voxel) for file in files), known, None)
