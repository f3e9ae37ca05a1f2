"""Streams of seeds for augmentations: one in the main process, one in every worker of a DataLoader."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from weakref import WeakValueDictionary

import torch
from torch.utils.data import get_worker_info

from torchreg.errors import expect


class SeedStream:
    """An endless sequence of seeds that follow from a generator.

    A worker of a ``DataLoader`` holds a copy of the generator, in the same state as every other worker's. So in a
    worker the stream starts anew from a draw of that copy and the worker's own seed, which differs between workers and
    between epochs and follows from the ``generator`` of the ``DataLoader`` (or from ``torch.manual_seed``).

    The generator is one of the CPU and advanced by every seed; ``None`` makes one with seed 0. Another device raises
    ``ValueError``.
    """

    def __init__(self, generator: torch.Generator | None) -> None:
        if generator is None:
            generator = torch.Generator().manual_seed(0)
        expect(isinstance(generator, torch.Generator), "generator", "a torch.Generator or None", generator)
        expect(generator.device.type == "cpu", "generator", "a CPU generator", generator.device)
        self._portable = _portable(generator)
        self._in_worker: torch.Generator | None = None
        self._worker_seed: int | None = None

    def draw(self, count: int) -> list[int]:
        """The next ``count`` seeds, one after another."""
        worker = get_worker_info()
        if worker is None:
            generator = self._portable.generator
        elif self._in_worker is None or worker.seed != self._worker_seed:
            generator = generator_of(derived_seed(_draw(self._portable.generator), worker.seed))
            self._in_worker, self._worker_seed = generator, worker.seed
        else:
            generator = self._in_worker
        return [_draw(generator) for _ in range(count)]

    def __getstate__(self) -> dict[str, object]:
        return {"_portable": self._portable, "_in_worker": None, "_worker_seed": None}


def derived_seed(seed: int, *parts: int | str) -> int:
    """A seed in [0, 2^63) that follows from another seed and its purpose; unlike parts give unrelated seeds."""
    text = repr((seed, *parts)).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little") >> 1


def generator_of(seed: int) -> torch.Generator:
    """A CPU generator with this seed."""
    return torch.Generator().manual_seed(seed)


def _draw(generator: torch.Generator) -> int:
    return int(torch.randint(2**62, (1,), generator=generator).item())


class _PortableGenerator:
    """A generator that can be pickled to another process.

    Its state goes as bytes, since a tensor may be gone before a spawned worker fetches it. There is one of these for
    each generator, so that streams which share a generator here share its copy there.
    """

    def __init__(self, generator: torch.Generator) -> None:
        self.generator = generator

    def __reduce__(self) -> tuple[Callable[[bytes], _PortableGenerator], tuple[bytes]]:
        return _from_state, (self.generator.get_state().numpy().tobytes(),)


_PORTABLE: WeakValueDictionary[int, _PortableGenerator] = WeakValueDictionary()


def _portable(generator: torch.Generator) -> _PortableGenerator:
    """The only one for this generator; it keeps the generator alive, so that no other has its ``id`` meanwhile."""
    return _PORTABLE.setdefault(id(generator), _PortableGenerator(generator))


def _from_state(state: bytes) -> _PortableGenerator:
    generator = torch.Generator()
    generator.set_state(torch.frombuffer(bytearray(state), dtype=torch.uint8))
    return _portable(generator)
