"""Seeds that follow from the call and from what a pair holds, so that it draws the same wherever it stands."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.errors import expect

_MASK = (1 << 64) - 1


def base_seed(generator: torch.Generator | None) -> int:
    """One number from a generator, advancing it; 0 for ``None``. The global generator is left alone."""
    if generator is None:
        return 0
    device = generator.device
    drawn = torch.randint(2**62, (1,), generator=generator, device=device)
    return int(drawn.item())


def pair_seed(seed: int, source: Tensor, target: Tensor) -> int:
    """A seed from ``seed`` and the correspondences (M,) of one pair, counted from the first row of its clouds.

    A pair is recognized by what it holds, so its draws do not depend on its batch or its place in it.
    """
    return pair_seeds(seed, source, target, [len(source)])[0]


def pair_seeds(seed: int, source: Tensor, target: Tensor, counts: Sequence[int]) -> list[int]:
    """``pair_seed`` of several pairs with so many correspondences each, one pair's after another's."""
    expect(source.shape == target.shape, "target", f"{tuple(source.shape)}", target)
    lengths = torch.tensor(counts, dtype=torch.int64, device=source.device)
    ends = lengths.cumsum(dim=0)
    place = torch.arange(1, len(source) + 1, device=source.device)
    place -= (ends - lengths).repeat_interleave(lengths)
    # sums of int64 wrap around and are exact in any order; so are differences of such sums
    print_ = (source * 0x9E3779B1 + target * 0x85EBCA77 + 1) * (place * 0xC2B2AE3D + 0x27D4EB2F)
    total = torch.nn.functional.pad(print_.cumsum(dim=0), (1, 0))
    own: list[int] = (total[ends] - total[ends - lengths]).tolist()
    return [_mix((_mix(seed) + number + count) & _MASK) >> 1 for number, count in zip(own, counts, strict=True)]


def _mix(value: int) -> int:
    """SplitMix64's finalizer: every bit of the input moves every bit of the output."""
    value = (value + 0x9E3779B97F4A7C15) & _MASK
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & _MASK
    return value ^ (value >> 31)
