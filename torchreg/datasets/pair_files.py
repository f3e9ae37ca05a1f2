"""What datasets of pairs have in common: a list of files and truths, read when an item is asked for."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from torch import Tensor
from torch.utils.data import Dataset

from torchreg.datasets.cloud_files import CloudFiles, CloudReader
from torchreg.types.scan_pair import ScanPair


class PairFiles(Dataset[ScanPair]):
    """Pairs of cloud files. Items are read in the process that asks; nothing is kept.

    Attributes:
        sources: the files of the source clouds, one a pair.
        targets: the files of the target clouds.
        names: one a pair.
        T_target_source: (N, 4, 4) float64, meters; NaN throughout where the truth is not known. One tensor for
            all pairs, since each tensor costs a file descriptor on its way to a spawned worker.
        information: (N, 6, 6) float64, NaN throughout where there is none; ``None`` where no pair has one.
        reader: how clouds are read.
        transform: what each pair goes through once it is read, or ``None``.
    """

    def __init__(
        self,
        sources: Sequence[Path],
        targets: Sequence[Path],
        names: Sequence[str],
        truths: Sequence[Tensor | None],
        information: Sequence[Tensor | None],
        reader: CloudReader,
        transform: Callable[[ScanPair], ScanPair] | None = None,
    ) -> None:
        self.sources, self.targets, self.names = tuple(sources), tuple(targets), tuple(names)
        self.reader, self.transform = reader, transform
        self.T_target_source = _stacked(truths, 4)
        self.information = None if all(one is None for one in information) else _stacked(information, 6)

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


def _stacked(matrices: Sequence[Tensor | None], size: int) -> Tensor:
    """(N, size, size) float64, NaN for ``None``."""
    unknown = torch.full((size, size), float("nan"), dtype=torch.float64)
    return torch.stack([unknown if matrix is None else matrix for matrix in matrices])
