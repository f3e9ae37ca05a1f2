"""Several scan pairs as one packed batch: what a ``DataLoader`` hands to a training step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.errors import expect, expect_dtype, expect_shape
from torchreg.types.clouds import Clouds
from torchreg.types.scan_pair import ScanPair


@dataclass(frozen=True, eq=False)
class ScanPairBatch:
    """``B`` scan pairs, their clouds packed.

    Attributes:
        source: B clouds.
        target: B clouds, in the order of the source.
        T_target_source: (B, 4, 4) float64, meters, the true motions, origins included; NaN throughout where
            one is not known.
        names: of the pairs.
        information: (B, 6, 6) float64, NaN throughout where there is none; ``None`` where no pair has one.

    Raises:
        ValueError: as many sources, targets, matrices and names are not there, or a matrix has another dtype.
    """

    source: Clouds
    target: Clouds
    T_target_source: Tensor
    names: tuple[str, ...]
    information: Tensor | None = None

    def __post_init__(self) -> None:
        pairs = len(self.names)
        for name, clouds in (("source", self.source), ("target", self.target)):
            expect(len(clouds) == pairs, name, f"{pairs} clouds, one for every name", f"{len(clouds)}")
        expect_shape(self.T_target_source, "T_target_source", (pairs, 4, 4))
        expect_dtype(self.T_target_source, "T_target_source", torch.float64)
        if self.information is not None:
            expect_shape(self.information, "information", (pairs, 6, 6))
            expect_dtype(self.information, "information", torch.float64)

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

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> ScanPairBatch:
        """Copy to a device or change the dtype of the clouds, as ``Clouds.to``; the matrices stay float64."""
        return self._mapped(lambda clouds: clouds.to(device, dtype), lambda matrix: matrix.to(device=device))

    def pin_memory(self) -> ScanPairBatch:
        """Copy into page-locked memory; a ``DataLoader`` with ``pin_memory=True`` calls this where there is a GPU."""
        return self._mapped(Clouds.pin_memory, Tensor.pin_memory)

    def _mapped(self, clouds: Callable[[Clouds], Clouds], matrix: Callable[[Tensor], Tensor]) -> ScanPairBatch:
        return ScanPairBatch(
            source=clouds(self.source),
            target=clouds(self.target),
            T_target_source=matrix(self.T_target_source),
            names=self.names,
            information=None if self.information is None else matrix(self.information),
        )


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
    names = tuple(pair.name for pair in pairs)
    information = None
    if any(pair.information is not None for pair in pairs):
        unknown = pairs[0].T_target_source.new_full((6, 6), float("nan"))
        information = torch.stack([unknown if pair.information is None else pair.information for pair in pairs])
    return ScanPairBatch(
        source=_packed("source", [pair.source for pair in pairs], names),
        target=_packed("target", [pair.target for pair in pairs], names),
        T_target_source=torch.stack([pair.T_target_source for pair in pairs]),  # (B, 4, 4)
        names=names,
        information=information,
    )


def _packed(side: str, clouds: list[Clouds], names: tuple[str, ...]) -> Clouds:
    """``Clouds.pack`` after a check that can name the pairs."""
    for what in ("colors", "normals"):
        there = [getattr(cloud, what) is not None for cloud in clouds]
        if any(there) and not all(there):
            has, lacks = names[there.index(True)], names[there.index(False)]
            received = f"them for {has} and none for {lacks} (the dataset's {what}=False drops them)"
            raise ValueError(f"{side}: expected {what} for all clouds of a batch or for none, got {received}")
    return Clouds.pack(clouds)
