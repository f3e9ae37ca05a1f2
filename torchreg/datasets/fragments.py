"""A dataset of fragments in folders as 3DMatch, Redwood and the ETH scenes are published."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import torch

from torchreg.arguments import checked
from torchreg.datasets.cloud_files import CloudReader
from torchreg.datasets.scan_pairs import FilePair, PairFiles
from torchreg.errors import CloudFileError, expect
from torchreg.io.placement import Viewpoint
from torchreg.io.redwood_log import read_redwood_info, read_redwood_log
from torchreg.types.scan_pair import ScanPair

_EVALUATION = "-evaluation"
_FRAGMENTS = ("cloud_bin_{}.ply", "Hokuyo_{}.ply")
"""File names of fragments: in 3DMatch and Redwood, and in the ETH scenes."""


class Fragments(PairFiles):
    """The pairs that the ``gt.log`` of a scene lists, or of every scene in a folder.

    A scene is a folder of fragments ``cloud_bin_0.ply``, ``cloud_bin_1.ply``, ..., or ``Hokuyo_0.ply``, ... as in the
    ETH scenes of Gojcic et al., The Perfect Match, CVPR 2019, doi:10.1109/CVPR.2019.00569. Its log is ``gt.log`` in
    the folder itself or in its sibling ``SCENE-evaluation``, as in the public archive; where there is neither, the
    only other ``*.log`` of the two. ``log`` names another one, such as that of 3DLoMatch. A block ``i j n`` of the log
    holds the matrix that takes points of fragment j into the frame of fragment i, so here fragment j is the source,
    fragment i the target, and ``T_target_source`` the matrix as it stands. Information comes from ``gt.info`` beside
    the log, where there is one.

    Items are ``ScanPair`` named by scene and fragments, ``SCENE__cloud_bin_j__cloud_bin_i``; ``pack_pairs`` is the
    ``collate_fn``. Zeng et al., 3DMatch, CVPR 2017, doi:10.1109/CVPR.2017.29.

    Attributes:
        scenes: the scene of every pair, by its folder's name.
        numbers: i and j of every pair, as its log has them: fragment j is the source.

    Args:
        folder: a scene, or a folder of scenes, which come in the order of their names.
        log: which log to read. ``None``: ``gt.log`` as above. The name of a file in the scene or in its
            ``-evaluation`` sibling, such as ``gt_lo.log``. Or a folder with ``SCENE/gt.log`` for every scene, as
            3DMatch and 3DLoMatch come with Huang et al., Predator, CVPR 2021, doi:10.1109/CVPR46437.2021.00425. Its
            information lies beside it under the same name with the suffix ``.info``.
        voxel_size, viewpoint, dtype, colors, normals, device, transform: as for ``ScanPairs``.

    Raises:
        CloudFileError: no fragments or no log, a log that cannot be read or is cut short, a matrix that is not
            rigid, a pair twice, a missing fragment, or a ``gt.info`` without a pair of the log.
        ValueError: another argument is invalid.

    Example:
        >>> import torch, torchreg as tr
        >>> from pathlib import Path
        >>> Path("scene").mkdir(exist_ok=True)
        >>> for number in range(2):
        ...     tr.write_cloud(f"scene/cloud_bin_{number}.ply", tr.Clouds(torch.rand(10, 3)))
        >>> _ = Path("scene/gt.log").write_text("0 1 2\\n1 0 0 0\\n0 1 0 0\\n0 0 1 0\\n0 0 0 1\\n")
        >>> fragments = tr.datasets.Fragments("scene")
        >>> len(fragments), fragments[0].name
        (1, 'scene__cloud_bin_1__cloud_bin_0')
    """

    @checked
    def __init__(
        self,
        folder: str | os.PathLike[str],
        *,
        log: str | os.PathLike[str] | None = None,
        voxel_size: float | None = None,
        viewpoint: Viewpoint = "auto",
        dtype: torch.dtype = torch.float32,
        colors: bool | None = None,
        normals: bool | None = None,
        device: torch.device | str | None = None,
        transform: Callable[[ScanPair], ScanPair] | None = None,
    ) -> None:
        reader = CloudReader(
            voxel_size=voxel_size, viewpoint=viewpoint, dtype=dtype, colors=colors, normals=normals, device=device
        )
        expect(Path(folder).is_dir(), "folder", "a folder that exists", os.fspath(folder))
        listed = [entry for scene in _scenes(Path(os.path.abspath(folder))) for entry in _pairs(scene, log)]
        self.scenes = tuple(pair.source.parent.name for _, pair in listed)
        self.numbers = tuple(numbers for numbers, _ in listed)
        super().__init__([pair for _, pair in listed], reader, transform)


def _scenes(folder: Path) -> list[Path]:
    """The folder itself if it holds fragments or a log, else its folders that do."""
    if _is_scene(folder):
        return [folder]
    scenes = [inner for inner in sorted(folder.iterdir()) if inner.is_dir() and _is_scene(inner)]
    if not scenes:
        raise CloudFileError(f"{folder}: expected fragments cloud_bin_0.ply, ... in it or in folders of it, got none")
    return scenes


def _is_scene(folder: Path) -> bool:
    if any(any(folder.glob(name.format("*"))) for name in _FRAGMENTS):
        return True
    scene = folder.name.removesuffix(_EVALUATION)
    is_partner = scene != folder.name and folder.with_name(scene).is_dir()
    return (folder / "gt.log").exists() and not is_partner


def _log(scene: Path, wanted: str | os.PathLike[str] | None) -> Path:
    """The file with the true motions of a scene."""
    beside = scene.with_name(scene.name + _EVALUATION)
    places, name = (scene, beside), "gt.log"
    if wanted is not None and Path(wanted).is_dir():
        places = (Path(wanted) / scene.name, Path(wanted) / beside.name)
    elif wanted is not None:
        name = os.fspath(wanted)
        plain = name == Path(name).name
        expect(plain, "log", "the name of a file in each scene, or a folder that exists", name)
    for place in places:
        if (place / name).is_file():
            return place / name
    if wanted is not None:
        raise CloudFileError(f"{scene}: expected {places[0] / name} or {places[1] / name}, got neither")
    others = [log for place in places for log in sorted(place.glob("*.log"))]
    if len(others) != 1:
        received = ", ".join(log.name for log in others) or "none"
        raise CloudFileError(f"{scene}: expected gt.log in it or in {beside.name} beside it, got {received}")
    return others[0]


def _pairs(scene: Path, wanted: str | os.PathLike[str] | None) -> list[tuple[tuple[int, int], FilePair]]:
    """The pairs of a scene with their numbers i and j in the log."""
    log = _log(scene, wanted)
    file_name = next((name for name in _FRAGMENTS if any(scene.glob(name.format("*")))), _FRAGMENTS[0])
    info = log.with_suffix(".info")
    information = read_redwood_info(info) if info.exists() else None
    pairs = []
    for entry in read_redwood_log(log):
        source, target = (scene / file_name.format(number) for number in (entry.j, entry.i))
        where = f"{log}, line {entry.line}"
        for fragment in (target, source):
            if not fragment.is_file():
                raise CloudFileError(f"{where}: expected a fragment that is there, got no file {fragment}")
        numbers = entry.i, entry.j
        if information is not None and numbers not in information:
            raise CloudFileError(f"{info}: expected every pair of {log.name}, got none for {entry.i} {entry.j}")
        name = f"{scene.name}__{source.stem}__{target.stem}"
        known = None if information is None else information[numbers]
        pairs.append((numbers, FilePair(source, target, name, entry.T_i_j, known)))
    return pairs
