"""Where augmentations take their seeds from: one stream in the main process, one in every worker of a DataLoader."""

from __future__ import annotations

import hashlib

import torch
from torch.utils.data import get_worker_info

from torchreg.errors import expect


class SeedStream:
    """An endless row of seeds that follow from a generator.

    A worker of a ``DataLoader`` holds a copy of the generator, in the same state as every other worker's. So in a
    worker the stream starts anew from a draw of that copy and the worker's own seed, which differs between workers and
    between epochs and follows from the ``generator`` of the ``DataLoader`` (or from ``torch.manual_seed``).

    Args:
        generator: a CPU generator, advanced by every seed; ``None`` makes one with seed 0.

    Raises:
        ValueError: a generator on another device.
    """

    def __init__(self, generator: torch.Generator | None) -> None:
        if generator is None:
            generator = torch.Generator().manual_seed(0)
        expect(isinstance(generator, torch.Generator), "generator", "a torch.Generator or None", generator)
        expect(generator.device.type == "cpu", "generator", "a CPU generator", generator.device)
        self._given = generator
        self._own = generator
        self._worker_seed: int | None = None

    def draw(self, count: int) -> list[int]:
        """The next ``count`` seeds, one after another."""
        worker = get_worker_info()
        if worker is not None and worker.seed != self._worker_seed:
            self._worker_seed = worker.seed
            self._own = generator_of(derived_seed(_draw(self._given), worker.seed))
        return [_draw(self._own) for _ in range(count)]


def derived_seed(seed: int, *parts: int | str) -> int:
    """A seed in [0, 2^63) that follows from another and from what it is for; unlike parts give unrelated seeds."""
    text = repr((seed, *parts)).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little") >> 1


def generator_of(seed: int) -> torch.Generator:
    """A CPU generator with this seed."""
    return torch.Generator().manual_seed(seed)


def _draw(generator: torch.Generator) -> int:
    return int(torch.randint(2**62, (1,), generator=generator).item())
