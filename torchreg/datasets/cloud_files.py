"""Clouds read from files when they are indexed, in the process that indexes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch.utils.data import Dataset, get_worker_info

from torchreg.arguments import checked, checked_record
from torchreg.errors import expect, expect_in_words, positive
from torchreg.io import read_cloud
from torchreg.io.assemble import checked_dtype
from torchreg.io.placement import Viewpoint, checked_viewpoint
from torchreg.preprocess import voxel_downsample
from torchreg.types.clouds import Clouds


@checked_record
@dataclass(frozen=True, eq=False, kw_only=True)
class CloudReader:
    """How the datasets read a cloud.

    Attributes:
        voxel_size: meters, for ``voxel_downsample`` right after reading; ``None`` keeps all points.
        viewpoint: where the scanner stood, as for ``read_cloud``.
        dtype: of the clouds, float32 or float64.
        colors: ``None`` leaves clouds as they are, ``False`` drops colors, ``True`` refuses a cloud without.
        normals: likewise.
        device: where a cloud goes once it is read; ``None`` is the CPU. Workers of a ``DataLoader`` cannot hand
            tensors of a GPU on and refuse it: move each batch instead.

    Raises:
        ValueError: an invalid option; the message names it.

    Example:
        >>> import torchreg as tr
        >>> tr.datasets.CloudReader(voxel_size=0.05, colors=True).viewpoint
        'auto'
    """

    voxel_size: float | None = None
    viewpoint: Viewpoint = "auto"
    dtype: torch.dtype = torch.float32
    colors: bool | None = None
    normals: bool | None = None
    device: torch.device | str | None = None

    def __post_init__(self) -> None:
        if self.voxel_size is not None:
            positive(self.voxel_size, "voxel_size")
        checked_viewpoint(self.viewpoint)
        checked_dtype(self.dtype)
        for name, wanted in (("colors", self.colors), ("normals", self.normals)):
            expect(wanted is None or isinstance(wanted, bool), name, "True, False or None", wanted)
        try:
            device = torch.device("cpu" if self.device is None else self.device)
        except (RuntimeError, TypeError):
            raise ValueError(f"device: expected a device such as 'cpu' or 'cuda:0', got {self.device!r}") from None
        object.__setattr__(self, "device", device)

    def read(self, path: Path) -> Clouds:
        """Read one cloud.

        Raises:
            CloudFileError: the file cannot be read.
            ValueError: no colors (normals) where they must be there, or a GPU as the device in a worker.
        """
        device = torch.device("cpu" if self.device is None else self.device)
        if device.type != "cpu" and get_worker_info() is not None:
            advice = f"{device} (leave it out, and move each batch with batch.to({str(device)!r}))"
            raise ValueError(f"device: expected the CPU in workers of a DataLoader, got {advice}")
        cloud = read_cloud(path, viewpoint=self.viewpoint, dtype=self.dtype)
        for name, wanted in (("colors", self.colors), ("normals", self.normals)):
            missing = wanted is True and getattr(cloud, name) is None
            expect_in_words(not missing, str(path), f"a cloud with {name}, as {name}=True asks for", "one without")
        cloud = replace(
            cloud,
            colors=None if self.colors is False else cloud.colors,
            normals=None if self.normals is False else cloud.normals,
        )
        if self.voxel_size is not None:
            cloud = voxel_downsample(cloud, self.voxel_size)
        return cloud.to(device)


class CloudFiles(Dataset[Clouds]):
    """Clouds of a list of files; ``Clouds.pack`` is the ``collate_fn`` for a ``DataLoader`` over it.

    Attributes:
        paths: the files, one an item.
        reader: reads them.

    Example:
        >>> import torch, torchreg as tr
        >>> from pathlib import Path
        >>> tr.write_cloud("one.ply", tr.Clouds(torch.rand(10, 3)))
        >>> files = tr.datasets.CloudFiles([Path("one.ply")], tr.datasets.CloudReader())
        >>> len(files), len(files[0].points)
        (1, 10)
    """

    @checked
    def __init__(self, paths: Sequence[Path], reader: CloudReader) -> None:
        self.paths = tuple(paths)
        self.reader = reader

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Clouds:
        """Read one cloud; errors are those of ``CloudReader.read``."""
        return self.reader.read(self.paths[index])
