"""A dataset of the pairs that a table lists."""

from __future__ import annotations

import os
from collections.abc import Callable

import torch

from torchreg.datasets.cloud_files import CloudReader
from torchreg.datasets.pair_files import PairFiles
from torchreg.errors import CloudFileError
from torchreg.io import read_pairs_file
from torchreg.io.placement import Viewpoint
from torchreg.types.scan_pair import ScanPair


class ScanPairs(PairFiles):
    """The pairs of a table with the columns ``source``, ``target`` and, where wanted, ``truth`` and ``name``.

    The table is read at once, the clouds when an item is asked for: in the worker, where a ``DataLoader`` has
    some. Items are ``ScanPair``; ``pack_pairs`` is the ``collate_fn``. See ``read_pairs_file`` for the form of the
    table; columns of other names are legal and not looked at.

    Args:
        path: the table.
        root: the folder that relative file names start from; ``None`` takes the folder of the table.
        voxel_size: meters; each cloud is thinned by ``voxel_downsample`` right after reading. ``None`` keeps
            all points.
        viewpoint: where the scanners stood, as ``read_cloud`` takes it.
        dtype: of the clouds, float32 or float64.
        colors: ``None`` takes clouds as they come, ``False`` drops colors, ``True`` refuses a cloud without. A
            batch holds colors for all of its sources (targets) or for none.
        normals: likewise.
        device: where items go once they are read. Workers of a ``DataLoader`` refuse a GPU: there, leave it out
            and move each batch with ``batch.to(device)``.
        transform: what each pair goes through once it is read, such as an ``augment.AugmentPair``.

    Raises:
        CloudFileError: the table cannot be read, or lists a cloud that is not there.
        ValueError: another argument cannot be meant.

    Example:
        >>> import pathlib, tempfile, torchreg as tr
        >>> from torch.utils.data import DataLoader
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for name in ("a", "b", "c"):
        ...         tr.write_cloud(f"{folder}/{name}.ply", tr.Clouds(torch.rand(9, 3)))
        ...     _ = pathlib.Path(folder, "pairs.csv").write_text("source,target\\na.ply,b.ply\\nb.ply,c.ply\\n")
        ...     loader = DataLoader(ScanPairs(f"{folder}/pairs.csv"), batch_size=2, collate_fn=tr.datasets.pack_pairs)
        ...     [batch.names for batch in loader]
        [('a__b', 'b__c')]
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        root: str | os.PathLike[str] | None = None,
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
        rows = read_pairs_file(path, root)
        for row in rows:
            for side, file in (("source", row.source), ("target", row.target)):
                if not file.is_file():
                    where = f"{os.fspath(path)}, line {row.line}"
                    raise CloudFileError(f"{where}: expected a {side} cloud that is there, got no file {file}")
        super().__init__(
            sources=[row.source for row in rows],
            targets=[row.target for row in rows],
            names=[row.name for row in rows],
            truths=[row.T_target_source for row in rows],
            information=[None] * len(rows),
            reader=reader,
            transform=transform,
        )
