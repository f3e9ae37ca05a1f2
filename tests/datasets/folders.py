"""Small folders of clouds, with a table of pairs or with a log, for the tests of datasets."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torchreg.geometry.kabsch import kabsch
from torchreg.io import write_cloud
from torchreg.types import Clouds


def cloud(seed: int, colors: bool = True, normals: bool = False, far: bool = False) -> Clouds:
    """Some 200 points in a cube of 2 m, of which every seed has another number."""
    draw = torch.Generator().manual_seed(seed)
    count = 200 + seed
    directions = torch.rand(count, 3, generator=draw) + 0.1
    return Clouds(
        points=2 * torch.rand(count, 3, generator=draw),
        colors=torch.randint(0, 256, (count, 3), generator=draw) / 255 if colors else None,
        normals=directions / directions.norm(dim=1, keepdim=True) if normals else None,
        origin=torch.tensor([[5e5, 4e6, 100.0]], dtype=torch.float64) if far else None,
        viewpoint=torch.rand(1, 3, generator=draw),
    )


def motion(seed: int) -> Tensor:
    """(4, 4) float64, rigid."""
    draw = torch.Generator().manual_seed(seed)
    first, second = torch.rand(2, 5, 3, generator=draw, dtype=torch.float64)
    return kabsch(first, second)


def words(T: Tensor) -> str:
    """The sixteen numbers of a matrix, with every digit."""
    return " ".join(map(repr, T.flatten().tolist()))


def table_folder(folder: Path, pairs: int = 3, colored: tuple[int, ...] = tuple(range(9))) -> Path:
    """Write clouds 0 to ``pairs`` and a table that pairs each with the next; the last has no truth."""
    lines = ["source,target,truth"]
    for k in range(pairs + 1):
        write_cloud(folder / f"{k}.npz", cloud(k, colors=k in colored, far=k == 1))
    for k in range(pairs):
        lines.append(f"{k}.npz,{k + 1}.npz,{words(motion(k)) if k < pairs - 1 else ''}")
    path = folder / "pairs.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def block(i: int, j: int, count: int, matrix: Tensor) -> str:
    """A block of a log or of its information."""
    rows = ["\t".join(map(repr, row)) for row in matrix.tolist()]
    return "\n".join([f"{i}\t{j}\t{count}", *rows, ""])


def scene_folder(scene: Path, logs: Path | None = None, information: bool = False) -> Path:
    """Write fragments 0, 1 and 2 with a log of two pairs (in ``logs``, if given)."""
    logs = scene if logs is None else logs
    for folder in (scene, logs):
        folder.mkdir(parents=True, exist_ok=True)
    for k in range(3):
        write_cloud(scene / f"cloud_bin_{k}.ply", cloud(k))
    pairs = ((0, 1), (0, 2))
    (logs / "gt.log").write_text("".join(block(i, j, 3, motion(j)) for i, j in pairs))
    if information:
        matrices = [torch.full((6, 6), float(j), dtype=torch.float64) for _, j in pairs]
        (logs / "gt.info").write_text("".join(block(i, j, 3, one) for (i, j), one in zip(pairs, matrices, strict=True)))
    return scene
