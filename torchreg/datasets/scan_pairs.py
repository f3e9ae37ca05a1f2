"""Datasets of pairs of cloud files: what they share, and the pairs that a table lists."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.data import Dataset

from torchreg.arguments import checked
from torchreg.datasets.cloud_files import CloudFiles, CloudReader
from torchreg.errors import CloudFileError
from torchreg.io import read_pairs_file
from torchreg.io.placement import Viewpoint
from torchreg.types.scan_pair import ScanPair


class FilePair(NamedTuple):
    """The files of one pair, and its truth where that is known."""

    source: Path
    target: Path
    name: str
    T_target_source: Tensor | None
    information: Tensor | None = None


class PairFiles(Dataset[ScanPair]):
    """Pairs of cloud files. An item is read each time it is indexed, in the process that indexes it; nothing is cached.

    Attributes:
        sources: the files of the source clouds, one a pair.
        targets: the files of the target clouds.
        names: one a pair.
        T_target_source: (N, 4, 4) float64, meters; NaN throughout where the truth is not known. One tensor for
            all pairs, since each tensor costs a file descriptor on its way to a spawned worker.
        information: (N, 6, 6) float64, NaN throughout where there is none; ``None`` where no pair has one.
        reader: reads the clouds.
        transform: applied to each pair once it is read, or ``None``.
    """

    def __init__(
        self, pairs: Sequence[FilePair], reader: CloudReader, transform: Callable[[ScanPair], ScanPair] | None
    ) -> None:
        self.sources = tuple(pair.source for pair in pairs)
        self.targets = tuple(pair.target for pair in pairs)
        self.names = tuple(pair.name for pair in pairs)
        self.reader, self.transform = reader, transform
        self.T_target_source = _stacked([pair.T_target_source for pair in pairs], 4)
        known = any(pair.information is not None for pair in pairs)
        self.information = _stacked([pair.information for pair in pairs], 6) if known else None

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> ScanPair:
        """Read one pair and transform it; errors are those of ``CloudReader.read`` and of the transform."""
        device = self.reader.device
        information = None if self.information is None else self.information[index]
        if information is not None and bool(information.isnan().all()):
            information = None
        pair = ScanPair(
            source=self.reader.read(self.sources[index]),
            target=self.reader.read(self.targets[index]),
            T_target_source=self.T_target_source[index].to(device, copy=True),
            name=self.names[index],
            information=None if information is None else information.to(device, copy=True),
        )
        return pair if self.transform is None else self.transform(pair)

    def clouds(self) -> CloudFiles:
        """The distinct clouds of all pairs, in the order in which they first come, sources before targets."""
        both = (path for pair in zip(self.sources, self.targets, strict=True) for path in pair)
        return CloudFiles(list({os.path.normpath(path): path for path in both}.values()), self.reader)


class ScanPairs(PairFiles):
    """The pairs of a table with the columns ``source``, ``target`` and, where wanted, ``truth`` and ``name``.

    The table is read at once, the clouds when an item is indexed: in the workers of a ``DataLoader``, where it has
    some. Items are ``ScanPair``; ``pack_pairs`` is the ``collate_fn``. ``read_pairs_file`` describes the form of the
    table; columns of other names are ignored.

    Args:
        path: the table, or the list of pairs as JSON.
        root: the folder that relative file names start from; ``None``: the folder of that file.
        voxel_size: meters; each cloud is thinned by ``voxel_downsample`` right after reading. ``None`` keeps
            all points.
        viewpoint: where the scanners stood, as for ``read_cloud``.
        dtype: of the clouds, float32 or float64.
        colors: ``None`` leaves clouds as they are, ``False`` drops colors, ``True`` refuses a cloud without. A
            batch holds colors for all of its sources (targets) or for none.
        normals: likewise.
        device: where items go once they are read. Workers of a ``DataLoader`` refuse a GPU: there, leave it out
            and move each batch with ``batch.to(device)``.
        transform: applied to each pair once it is read, such as an ``augment.AugmentPair``.

    Raises:
        CloudFileError: the table cannot be read, or lists a missing cloud.
        ValueError: another argument is invalid.

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

    @checked
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
                    raise CloudFileError(f"{row.where}: expected a {side} cloud that is there, got no file {file}")
        pairs = [FilePair(row.source, row.target, row.name, row.T_target_source) for row in rows]
        super().__init__(pairs, reader, transform)


def _stacked(matrices: Sequence[Tensor | None], size: int) -> Tensor:
    """(N, size, size) float64, NaN for ``None``."""
    unknown = torch.full((size, size), float("nan"), dtype=torch.float64)
    return torch.stack([unknown if matrix is None else matrix for matrix in matrices])
