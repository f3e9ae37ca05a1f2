"""Two scans of one place with the true motion between them, and packed batches of such pairs for a ``DataLoader``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import expect, expect_in_words, expect_shape
from torchreg.types.clouds import Clouds
from torchreg.types.collation import collated_by
from torchreg.types.held import Held, Listed, PerItem, held
from torchreg.types.record import PackedBatch, Record
from torchreg.types.shown import counted, listed, several, where


@collated_by("torchreg.datasets.pack_pairs")
@checked_record
@dataclass(frozen=True, eq=False, repr=False)
class ScanPair(Record):
    """A source scan, a target scan and their true motion, which a registration should find.

    Attributes:
        source: batch of one cloud in the frame of its own scanner.
        target: batch of one cloud in the frame of its own scanner.
        T_target_source: (4, 4) float64, meters, the true motion: ``x_target = R @ x_source + t``, origins
            included. NaN throughout where the truth is not known.
        name: of the pair, for reports.
        information: (6, 6) float64, the information matrix of the truth as 3DMatch gives it, or ``None``.

    Raises:
        ValueError: a batch of several clouds, or a matrix of another shape or dtype.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> type(pair).__name__, pair.name, pair.T_target_source.shape
        ('ScanPair', 'mall-1', torch.Size([4, 4]))
    """

    source: Clouds = held(PerItem())
    target: Clouds = held(PerItem())
    T_target_source: Tensor = held(PerItem())
    name: str = held(Held())
    information: Tensor | None = held(PerItem(), default=None)

    def __post_init__(self) -> None:
        for name, cloud in (("source", self.source), ("target", self.target)):
            expect_in_words(len(cloud) == 1, name, "one cloud", f"{len(cloud)} clouds")
        _check_matrices(self.T_target_source, self.information)

    @property
    def has_truth(self) -> bool:
        """Whether the true motion is known."""
        return bool(self.T_target_source.isfinite().all())

    def _facts(self) -> Sequence[str]:
        sizes = (counted(side.lengths) for side in (self.source, self.target))
        return (
            f"{self.name!r}, {' and '.join(sizes)} points",
            f"true motion {'known' if self.has_truth else 'not known'}",
            where(self.source.points),
        )


@checked_record
@dataclass(frozen=True, eq=False, repr=False)
class ScanPairBatch(PackedBatch):
    """``B`` scan pairs, their clouds packed.

    Attributes:
        source: B clouds.
        target: B clouds, in the order of the source.
        T_target_source: (B, 4, 4) float64, meters, the true motions, origins included; NaN throughout where
            one is not known.
        names: of the pairs.
        information: (B, 6, 6) float64, NaN throughout where there is none; ``None`` where no pair has one.

    Raises:
        ValueError: the numbers of sources, targets, matrices and names differ, or a matrix has another dtype.

    Example:
        >>> import torchreg as tr
        >>> batch = tr.datasets.pack_pairs([tr.datasets.mall(seed=s, angular_step=4.0) for s in (1, 2)])
        >>> batch.names, len(batch.source)
        (('mall-1', 'mall-2'), 2)
    """

    source: Clouds = held(PerItem())
    target: Clouds = held(PerItem())
    T_target_source: Tensor = held(PerItem())
    names: tuple[str, ...] = held(Listed(shown=True))
    information: Tensor | None = held(PerItem(gap=float("nan")), default=None)

    def __post_init__(self) -> None:
        pairs = len(self.names)
        for name, clouds in (("source", self.source), ("target", self.target)):
            expect_in_words(len(clouds) == pairs, name, f"{pairs} clouds, one for every name", f"{len(clouds)}")
        _check_matrices(self.T_target_source, self.information, pairs)

    def __len__(self) -> int:
        """The number of pairs, B."""
        return len(self.names)

    @property
    def has_truth(self) -> Tensor:
        """Whether the true motion of each pair is known, (B,) bool."""
        return self.T_target_source.isfinite().flatten(1).all(dim=1)

    def unpack(self) -> list[ScanPair]:
        """The pairs one by one; their tensors are views. Information that is NaN throughout comes as ``None``."""
        information: list[Tensor | None] = [None] * len(self)
        if self.information is not None:
            information = [None if bool(one.isnan().all()) else one for one in self.information]
        parts = zip(
            self.source.unpack(), self.target.unpack(), self.T_target_source, self.names, information, strict=True
        )
        return [ScanPair(*part) for part in parts]

    def _facts(self) -> Sequence[str]:
        known = int(self.has_truth.sum())
        return (
            f"{several(len(self), 'pairs')}: {listed(self.names)}",
            f"{counted(self.source.lengths)} and {counted(self.target.lengths)} points, true motion of {known} known",
            where(self.source.points),
        )


@entry
def pack_pairs(pairs: Sequence[ScanPair]) -> ScanPairBatch:
    """Join pairs into one batch: the ``collate_fn`` of a ``DataLoader`` over a dataset of pairs.

    Raises:
        ValueError: nothing to pack, or some sources (targets) have colors or normals and others have none;
            the message names a pair of each kind. ``colors=False`` or ``normals=False`` of the dataset drops
            them.

    Example:
        >>> cloud = Clouds(torch.rand(5, 3))
        >>> pair = ScanPair(cloud, cloud, torch.eye(4, dtype=torch.float64), "still")
        >>> pack_pairs([pair, pair]).source.lengths
        [5, 5]
    """
    pairs = list(pairs)
    expect(len(pairs) > 0, "pairs", "at least one pair", pairs)
    for side in ("source", "target"):
        _expect_alike(side, [getattr(pair, side) for pair in pairs], [pair.name for pair in pairs])
    return ScanPairBatch.pack(_of_one(pair) for pair in pairs)


def _of_one(pair: ScanPair) -> ScanPairBatch:
    information = None if pair.information is None else pair.information[None]
    return ScanPairBatch(pair.source, pair.target, pair.T_target_source[None], (pair.name,), information)


def _expect_alike(side: str, clouds: list[Clouds], names: list[str]) -> None:
    """Check that all clouds have colors and normals or none has; the message names a pair of each kind."""
    for what in ("colors", "normals"):
        present = [getattr(cloud, what) is not None for cloud in clouds]
        if any(present) and not all(present):
            has, lacks = names[present.index(True)], names[present.index(False)]
            received = f"them for {has} and none for {lacks} (the dataset's {what}=False drops them)"
            raise ValueError(f"{side}: expected {what} for all clouds of a batch or for none, got {received}")


def _check_matrices(T_target_source: Tensor, information: Tensor | None, *batch: int) -> None:
    """Check shapes (batch, 4, 4) and (batch, 6, 6) and the dtype."""
    matrices = [(T_target_source, "T_target_source", 4)]
    if information is not None:
        matrices.append((information, "information", 6))
    for matrix, name, size in matrices:
        expect_shape(matrix, name, (*batch, size, size), torch.float64)
