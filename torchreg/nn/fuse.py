"""Fusion with block weights to learn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor, nn

from torchreg.descriptors.fuse import fuse, rooted
from torchreg.errors import expect, fraction, positive
from torchreg.nn.precision import full_precision, widened
from torchreg.types import Features

_HISTOGRAMS = ("fpfh", "pcfh")  # blocks in percent


class Fuse(nn.Module):
    """``torchreg.fuse`` whose block weights are learned, as logarithms, so that they stay above 0.

    Args:
        weights: to begin with, one per descriptor, above 0. Two equal ones, FPFH's and PCFH's, are the paper's.
        root: in [0, 1], how far the entries of FPFH and PCFH are moved towards their square roots first, as in
            ``RegistrationOptions``.

    Attributes:
        log_weights: (blocks,) learnable.

    Raises:
        ValueError: no weights, one that is not above 0, or a root out of its range.
    """

    def __init__(self, weights: Sequence[float] = (1.0, 1.0), *, root: float = 0.0) -> None:
        super().__init__()
        self.root = fraction(root, "root", zero=True)
        expect(len(weights) > 0, "weights", "at least one", weights)
        self.log_weights = nn.Parameter(torch.tensor([positive(weight, "weights") for weight in weights]).log())

    @property
    def weights(self) -> Tensor:
        """(blocks,) above 0, what rows of unit length are multiplied by."""
        return widened(self.log_weights).exp()

    @full_precision
    def forward(self, *features: Features) -> Features:
        """Blocks of unit length, weighed and concatenated, as by ``torchreg.fuse``.

        Gradients flow to the features and to ``log_weights``.

        Args:
            features: descriptors of the same points, one per weight.

        Raises:
            ValueError: another number of descriptors, or descriptors of different points.
        """
        count = len(self.log_weights)
        expect(len(features) == count, "features", f"{count} descriptors, one per weight", len(features))
        plain = fuse(*map(self._rooted, features))
        weights = self.weights.to(plain.values)
        scale = torch.cat([weights[i].expand(item.values.shape[1]) for i, item in enumerate(features)])  # (D,)
        return replace(plain, values=plain.values * scale)

    def _rooted(self, item: Features) -> Features:
        if self.root == 0 or any(name not in _HISTOGRAMS for name, _ in item.blocks):
            return item
        return replace(item, values=rooted(item.values, self.root))

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return f"blocks={len(self.log_weights)}, root={self.root}"
