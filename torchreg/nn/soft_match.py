"""Soft matching with a temperature and a dustbin to learn."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from torchreg.errors import at_least, expect, one_of, positive
from torchreg.matching import soft_match
from torchreg.matching.soft import METHODS
from torchreg.nn.precision import full_precision, widened
from torchreg.types import Features, SoftCorrespondences


class SoftMatch(nn.Module):
    """``torchreg.soft_match`` whose temperature, as its logarithm, and dustbin are learned.

    The defaults fit what ``fuse`` makes of FPFH and PCFH: on simulated rooms true partners lie 0.02 to 0.15 apart in
    squares, the nearest features of all 0.01 to 0.07.

    Args:
        method: ``"dual_softmax"`` or ``"sinkhorn"``.
        temperature: to begin with, of squared distances of features, above 0.
        dustbin: to begin with, minus the squared distance from which on a point has rather no partner; ``None``
            leaves it out, which Sinkhorn cannot.
        iterations: of Sinkhorn.

    Attributes:
        log_temperature: () learnable.
        dustbin: () learnable, or ``None``.

    Raises:
        ValueError: an unknown method, a number out of its range, or Sinkhorn without a dustbin.
    """

    def __init__(
        self,
        *,
        method: str = "dual_softmax",
        temperature: float = 0.01,
        dustbin: float | None = -0.1,
        iterations: int = 50,
    ) -> None:
        super().__init__()
        self.method = one_of(method, "method", METHODS)
        self.iterations = at_least(iterations, "iterations", 1)
        expect(method == "dual_softmax" or dustbin is not None, "dustbin", "a number with Sinkhorn", dustbin)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(positive(temperature, "temperature"))))
        self.dustbin = None if dustbin is None else nn.Parameter(torch.tensor(float(dustbin)))

    @property
    def temperature(self) -> Tensor:
        """() above 0."""
        return widened(self.log_temperature).exp()

    @full_precision
    def forward(self, source: Features, target: Features) -> SoftCorrespondences:
        """Soft correspondences of B pairs; shapes, gradients and errors are those of ``torchreg.soft_match``."""
        return soft_match(
            source,
            target,
            method=self.method,
            temperature=self.temperature,
            dustbin=self.dustbin,
            iterations=self.iterations,
        )

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        rounds = f", iterations={self.iterations}" if self.method == "sinkhorn" else ""
        return f"method={self.method!r}{rounds}, dustbin={self.dustbin is not None}"
