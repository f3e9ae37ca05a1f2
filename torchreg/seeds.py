"""Seeds: any integer, of any size and sign, gives its own draws.

The generators underneath take less: torch's on the CPU reads the lowest 32 bits of a seed, so that 0 and 2^32 draw
alike, and takes -1 for 2^64 - 1; numpy's takes no negative number. So an integer that they take as it is goes there as
it is, and every other one as a hash of its digits.
"""

from __future__ import annotations

import hashlib
from numbers import Integral

import torch

from torchreg.errors import ArgumentTypeError, described_with_type

_TAKEN = 1 << 32  # seeds of torch's generator below this differ in what they draw


def any_seed(seed: int, name: str = "seed") -> int:
    """Return ``seed`` as an ``int`` if it is an integer, else raise ``ArgumentTypeError``."""
    if not isinstance(seed, Integral) or isinstance(seed, bool):
        raise ArgumentTypeError(f"{name}: expected an integer, got {described_with_type(seed)}")
    return int(seed)


def torch_seed(seed: int, name: str = "seed") -> int:
    """A seed in [0, 2^63) for ``torch.Generator``: the same below 2^32, else a hash."""
    seed = any_seed(seed, name)
    return seed if 0 <= seed < _TAKEN else _digest(seed, 8) >> 1


def numpy_seed(seed: int, name: str = "seed") -> int:
    """A seed for ``numpy.random.default_rng``: the same where it is not negative, else a hash of 128 bits."""
    seed = any_seed(seed, name)
    return seed if seed >= 0 else _digest(seed, 16)


def generator_of(seed: int) -> torch.Generator:
    """A CPU generator with this seed, which any integer may be."""
    return torch.Generator().manual_seed(torch_seed(seed))


def open3d_seed(seed: int) -> int:
    """A seed for Open3D's generator, which takes 31 bits."""
    seed = torch_seed(seed)
    return seed if seed < 1 << 31 else _digest(seed, 4) >> 1


def _digest(seed: int, size: int) -> int:
    return int.from_bytes(hashlib.blake2b(f"{seed:x}".encode(), digest_size=size).digest(), "little")
