"""Augmentation of scan pairs: both clouds change, and the true motion between them stays true."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import torch
from torch import nn

from torchreg.augment.augmentation import Augmentation
from torchreg.augment.streams import SeedStream, derived_seed
from torchreg.errors import expect
from torchreg.geometry.se3 import compose, inverse
from torchreg.types.scan_pair import ScanPair, ScanPairBatch

PairType = TypeVar("PairType", ScanPair, ScanPairBatch)


class AugmentPair(nn.Module):
    """Changes source and target each by draws of their own, and updates ``T_target_source``.

    With motions A of the source and B of the target, the new truth is B T inverse(A); a truth that is not known stays
    so. Information matrices are dropped, since they count an overlap that crops and thinning change. Works on one pair
    and on a batch, as ``transform`` of a dataset of pairs or behind a ``DataLoader`` on any device. In evaluation
    mode pairs are handed through. Streams in workers are those of ``Augmentation``.

    Args:
        source: what happens to sources.
        target: what happens to targets; ``None`` the same, by other draws.
        generator: a CPU generator for those of both that have none; ``None`` makes one with seed 0.

    Raises:
        ValueError: something else than an augmentation, or a generator that is not on the CPU.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=5.0)
        >>> moved = AugmentPair(tr.augment.RandomMotion())(pair)
        >>> torch.equal(moved.T_target_source, pair.T_target_source)
        False
    """

    def __init__(
        self, source: Augmentation, target: Augmentation | None = None, *, generator: torch.Generator | None = None
    ) -> None:
        super().__init__()
        target = source if target is None else target
        for name, side in (("source", source), ("target", target)):
            expect(isinstance(side, Augmentation), name, "an augmentation", side)
        self.source, self.target = source, target
        self._stream = SeedStream(generator)

    def forward(self, pair: PairType) -> PairType:
        """The changed pair or pairs; the type stays."""
        if not self.training:
            return pair
        seeds = self._stream.draw(len(pair.source))
        source = self.source.tracked(pair.source, [derived_seed(seed, "source") for seed in seeds])
        target = self.target.tracked(pair.target, [derived_seed(seed, "target") for seed in seeds])
        T = pair.T_target_source
        back = compose(T, inverse(source.T_new_old).to(T.device))
        moved = compose(target.T_new_old.to(T.device), back)  # (B, 4, 4)
        return replace(
            pair,
            source=source.clouds,
            target=target.clouds,
            T_target_source=moved.reshape(T.shape),
            information=None,
        )
