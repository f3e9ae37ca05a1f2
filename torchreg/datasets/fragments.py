"""A dataset of fragments in folders as 3DMatch and Redwood hand them out."""

from __future__ import annotations

import os
from pathlib import Path

import torch
from torch import Tensor

from torchreg.datasets.cloud_files import CloudReader
from torchreg.datasets.pair_files import PairFiles
from torchreg.errors import CloudFileError, expect
from torchreg.io.placement import Viewpoint
from torchreg.io.redwood_log import LogEntry, read_redwood_info, read_redwood_log

_EVALUATION = "-evaluation"


class Fragments(PairFiles):
    """The pairs that the ``gt.log`` of a scene lists, or of every scene in a folder.

    A scene is a folder of fragments ``cloud_bin_0.ply``, ``cloud_bin_1.ply``, ... Its log is ``gt.log`` in the
    folder itself or in its sibling ``SCENE-evaluation``, as the public archive has it; where neither is there, the
    only other ``*.log`` of the two. A block ``i j n`` of the log holds the matrix that takes points of fragment j into
    the frame of fragment i, so here fragment j is the source, fragment i the target, and ``T_target_source`` the
    matrix as it stands. Information comes from ``gt.info`` beside the log, where there is one.

    Items are ``ScanPair`` named ``SCENE__cloud_bin_j__cloud_bin_i``; ``pack_pairs`` is the ``collate_fn``. Zeng et
    al., 3DMatch, CVPR 2017, doi:10.1109/CVPR.2017.29.

    Args:
        folder: a scene, or a folder of scenes, which come in the order of their names.
        voxel_size: as for ``ScanPairs``, and so all that follow.
        viewpoint: as for ``ScanPairs``.
        dtype: as for ``ScanPairs``.
        colors: as for ``ScanPairs``.
        normals: as for ``ScanPairs``.
        device: as for ``ScanPairs``.

    Raises:
        CloudFileError: no fragments or no log, a log that cannot be read or is cut short, a matrix that is not
            rigid, a pair twice, a fragment that is not there, or a ``gt.info`` without a pair of the log.
        ValueError: another argument cannot be meant.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        *,
        voxel_size: float | None = None,
        viewpoint: Viewpoint = "auto",
        dtype: torch.dtype = torch.float32,
        colors: bool | None = None,
        normals: bool | None = None,
        device: torch.device | str | None = None,
    ) -> None:
        reader = CloudReader(
            voxel_size=voxel_size, viewpoint=viewpoint, dtype=dtype, colors=colors, normals=normals, device=device
        )
        expect(Path(folder).is_dir(), "folder", "a folder that exists", os.fspath(folder))
        pairs = [pair for scene in _scenes(Path(os.path.abspath(folder))) for pair in _pairs(scene)]
        super().__init__(
            sources=[source for source, _, _, _ in pairs],
            targets=[target for _, target, _, _ in pairs],
            names=[f"{source.parent.name}__{source.stem}__{target.stem}" for source, target, _, _ in pairs],
            truths=[entry.T_i_j for _, _, entry, _ in pairs],
            information=[information for _, _, _, information in pairs],
            reader=reader,
        )


def _scenes(folder: Path) -> list[Path]:
    """The folder itself where it holds fragments or a log, else those in it that do."""
    if _is_scene(folder):
        return [folder]
    scenes = [inner for inner in sorted(folder.iterdir()) if inner.is_dir() and _is_scene(inner)]
    if not scenes:
        raise CloudFileError(f"{folder}: expected fragments cloud_bin_0.ply, ... in it or in folders of it, got none")
    return scenes


def _is_scene(folder: Path) -> bool:
    if any(folder.glob("cloud_bin_*.ply")):
        return True
    scene = folder.name.removesuffix(_EVALUATION)
    is_partner = scene != folder.name and folder.with_name(scene).is_dir()
    return (folder / "gt.log").exists() and not is_partner


def _log(scene: Path) -> Path:
    """Where the true motions of a scene stand."""
    places = (scene, scene.with_name(scene.name + _EVALUATION))
    for place in places:
        if (place / "gt.log").exists():
            return place / "gt.log"
    others = [log for place in places for log in sorted(place.glob("*.log"))]
    if len(others) != 1:
        received = ", ".join(log.name for log in others) or "none"
        raise CloudFileError(f"{scene}: expected gt.log in it or in {places[1].name} beside it, got {received}")
    return others[0]


def _pairs(scene: Path) -> list[tuple[Path, Path, LogEntry, Tensor | None]]:
    """Source, target, motion and information of every pair of a scene."""
    log = _log(scene)
    info = log.with_suffix(".info")
    information = read_redwood_info(info) if info.exists() else None
    pairs = []
    for entry in read_redwood_log(log):
        source, target = (scene / f"cloud_bin_{number}.ply" for number in (entry.j, entry.i))
        where = f"{log}, line {entry.line}"
        for fragment in (target, source):
            if not fragment.is_file():
                raise CloudFileError(f"{where}: expected a fragment that is there, got no file {fragment}")
        if information is not None and (entry.i, entry.j) not in information:
            raise CloudFileError(f"{info}: expected every pair of {log.name}, got none for {entry.i} {entry.j}")
        pairs.append((source, target, entry, None if information is None else information[entry.i, entry.j]))
    return pairs
