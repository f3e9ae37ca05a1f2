"""What all augmentations have in common: a seed for every cloud, and a record of how clouds were moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from torchreg.augment.streams import SeedStream, derived_seed, generator_of
from torchreg.errors import expect, fraction
from torchreg.types import Clouds


@dataclass(frozen=True, eq=False)
class Tracked:
    """Changed clouds and how they were moved.

    Attributes:
        clouds: B clouds.
        T_new_old: (B, 4, 4) float64, meters, rigid, origins included: takes a point of an old cloud to where the
            new one has it. The identity where nothing was moved; noise and thinning are no motion.
    """

    clouds: Clouds
    T_new_old: Tensor


class Augmentation(nn.Module):
    """A random change of clouds; the base of all others.

    Every cloud of a batch takes one seed from the generator, in order, and all its draws follow from that seed: a
    batch gives the bits that its clouds give in single calls one after another. The global generator is left alone.
    In evaluation mode (``module.eval()``) clouds are handed through as they are, and nothing is drawn.

    In a ``DataLoader`` with workers every worker has a stream of its own, and another one every epoch; no
    ``worker_init_fn`` is needed. The streams follow from the state that the generator had when the loader started
    its workers and from the ``generator`` of the ``DataLoader``: give it one, and a run can be repeated to the bit with
    the same number of workers.

    Args:
        probability: that a cloud is changed at all.
        generator: a CPU generator; ``None`` makes one with seed 0. As a member of a ``Compose`` or an
            ``AugmentPair``, ``None`` takes seeds from there.

    Raises:
        ValueError: a probability outside [0, 1], or a generator that is not on the CPU.
    """

    def __init__(self, *, probability: float = 1.0, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.probability = fraction(probability, "probability", zero=True)
        self._has_generator = generator is not None
        self._stream = SeedStream(generator)

    def forward(self, clouds: Clouds) -> Clouds:
        """The changed clouds; their number and order stay."""
        return self.tracked(clouds).clouds

    def tracked(self, clouds: Clouds, seeds: Sequence[int] | None = None) -> Tracked:
        """The changed clouds and how they were moved.

        Args:
            clouds: B clouds, on any device.
            seeds: one a cloud, for a module without a generator of its own; ``None`` draws them.

        Raises:
            ValueError: another number of seeds.
        """
        if not self.training:
            return Tracked(clouds, unmoved(clouds))
        if seeds is None or self._has_generator:
            seeds = self._stream.draw(len(clouds))
        expect(len(seeds) == len(clouds), "seeds", f"{len(clouds)} numbers, one a cloud", len(seeds))
        return self._with_seeds(clouds, seeds)

    def _with_seeds(self, clouds: Clouds, seeds: Sequence[int]) -> Tracked:
        parts = [self._maybe_one(cloud, seed) for cloud, seed in zip(clouds.unpack(), seeds, strict=True)]
        if not parts:
            return Tracked(clouds, unmoved(clouds))
        return Tracked(Clouds.pack([part.clouds for part in parts]), torch.cat([part.T_new_old for part in parts]))

    def _maybe_one(self, cloud: Clouds, seed: int) -> Tracked:
        # the name: two augmentations of different kinds with equal generators draw unlike numbers
        draw = generator_of(derived_seed(seed, type(self).__name__))
        if float(torch.rand(1, generator=draw, dtype=torch.float64)) >= self.probability or len(cloud.points) == 0:
            return Tracked(cloud, unmoved(cloud))
        return self.one(cloud, draw)

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """The change of one cloud (B = 1, at least one point) by numbers from ``draw``; what a subclass writes."""
        raise NotImplementedError


def unmoved(clouds: Clouds) -> Tensor:
    """Identities (B, 4, 4) float64 on the device of the clouds."""
    return torch.eye(4, dtype=torch.float64, device=clouds.device).expand(len(clouds), 4, 4)


def uniform(low: float, high: float, draw: torch.Generator) -> float:
    """A number between ``low`` and ``high``."""
    return low + (high - low) * float(torch.rand(1, generator=draw, dtype=torch.float64))


def checked_range(value: tuple[float, float], name: str, low: float, high: float) -> tuple[float, float]:
    """Return two numbers that ascend within [low, high], else raise ``ValueError``."""
    legal = isinstance(value, (tuple, list)) and len(value) == 2
    legal = legal and all(isinstance(end, (int, float)) and not isinstance(end, bool) for end in value)
    expect(legal and low <= value[0] <= value[1] <= high, name, f"(low, high) within [{low:g}, {high:g}]", value)
    return float(value[0]), float(value[1])


def checked_size(value: float, name: str, unit: str, high: float = float("inf")) -> float:
    """Return a number in [0, high], finite, else raise ``ValueError``."""
    legal = isinstance(value, (int, float)) and not isinstance(value, bool) and 0 <= value <= high
    ends = "of at least 0" if high == float("inf") else f"in [0, {high:g}]"
    expect(legal and value < float("inf"), name, f"{unit} {ends}", value)
    return float(value)
