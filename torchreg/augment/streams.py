"""Where augmentations take their seeds from: one stream in the main process, one in every worker of a DataLoader."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from weakref import WeakValueDictionary

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
        self._given = _held(generator)
        self._in_worker: torch.Generator | None = None
        self._worker_seed: int | None = None

    def draw(self, count: int) -> list[int]:
        """The next ``count`` seeds, one after another."""
        worker = get_worker_info()
        if worker is None:
            own = self._given.generator
        elif self._in_worker is None or worker.seed != self._worker_seed:
            own = generator_of(derived_seed(_draw(self._given.generator), worker.seed))
            self._in_worker, self._worker_seed = own, worker.seed
        else:
            own = self._in_worker
        return [_draw(own) for _ in range(count)]

    def __getstate__(self) -> dict[str, object]:
        return {"_given": self._given, "_in_worker": None, "_worker_seed": None}


def derived_seed(seed: int, *parts: int | str) -> int:
    """A seed in [0, 2^63) that follows from another and from what it is for; unlike parts give unrelated seeds."""
    text = repr((seed, *parts)).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little") >> 1


def generator_of(seed: int) -> torch.Generator:
    """A CPU generator with this seed."""
    return torch.Generator().manual_seed(seed)


def _draw(generator: torch.Generator) -> int:
    return int(torch.randint(2**62, (1,), generator=generator).item())


class _Held:
    """A generator on its way to another process.

    It goes as bytes, since its state as a tensor may be gone before a spawned worker fetches it. There is one for each
    generator, so that streams which share a generator here share its copy there.
    """

    def __init__(self, generator: torch.Generator) -> None:
        self.generator = generator

    def __reduce__(self) -> tuple[Callable[[bytes], _Held], tuple[bytes]]:
        return _from_state, (self.generator.get_state().numpy().tobytes(),)


_HELD: WeakValueDictionary[int, _Held] = WeakValueDictionary()


def _held(generator: torch.Generator) -> _Held:
    """The one for this generator, which it keeps alive: no other can have its ``id`` meanwhile."""
    return _HELD.setdefault(id(generator), _Held(generator))


def _from_state(state: bytes) -> _Held:
    generator = torch.Generator()
    generator.set_state(torch.frombuffer(bytearray(state), dtype=torch.uint8))
    return _held(generator)
