"""Random changes of clouds and of pairs: the base of all augmentations, and those that run others.

Every cloud has a seed of its own, and a record of how it was moved.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import torch
from torch import Tensor, nn

from torchreg.arguments import checked
from torchreg.augment.streams import SeedStream, derived_seed, generator_of
from torchreg.entry import entry
from torchreg.errors import expect, finite, fraction
from torchreg.geometry.se3 import compose, inverse
from torchreg.types import Clouds
from torchreg.types.scan_pair import ScanPair, ScanPairBatch

PairType = TypeVar("PairType", ScanPair, ScanPairBatch)


@dataclass(frozen=True, eq=False)
class Tracked:
    """Changed clouds and how they were moved.

    Attributes:
        clouds: B clouds.
        T_new_old: (B, 4, 4) float64, meters, rigid, origins included: takes a point of an old cloud to its place in
            the new one. The identity where nothing was moved; noise and thinning are no motion.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(100, 3))
        >>> tracked = tr.augment.RandomMotion().tracked(cloud)
        >>> torch.allclose(tr.transform(cloud, tracked.T_new_old).points, tracked.clouds.points, atol=1e-5)
        True
    """

    clouds: Clouds
    T_new_old: Tensor


class Augmentation(nn.Module):
    """A random change of clouds; the base of all others.

    Every cloud of a batch takes one seed from the generator, in order, and all its draws follow from that seed: a
    batch gives the bits that its clouds give in single calls one after another. The global generator is left alone.
    In evaluation mode (``module.eval()``) clouds are returned unchanged, and nothing is drawn.

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

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(100, 3))
        >>> change = tr.augment.RandomMotion(generator=torch.Generator().manual_seed(0))
        >>> isinstance(change, tr.augment.Augmentation), len(change(cloud).points)
        (True, 100)
    """

    @checked
    def __init__(self, *, probability: float = 1.0, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.probability = fraction(probability, "probability", zero=True)
        self._has_generator = generator is not None
        self._stream = SeedStream(generator)

    def forward(self, clouds: Clouds) -> Clouds:
        """Change the clouds; their number and order stay."""
        return self.tracked(clouds).clouds

    @entry
    def tracked(self, clouds: Clouds, seeds: Sequence[int] | None = None) -> Tracked:
        """Change the clouds and return their motion too.

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
        parts = [self._maybe_one(cloud, seed) for cloud, seed in zip(clouds.unpack(), seeds, strict=True)]
        if not parts:
            return Tracked(clouds, unmoved(clouds))
        return Tracked(Clouds.pack([part.clouds for part in parts]), torch.cat([part.T_new_old for part in parts]))

    def _maybe_one(self, cloud: Clouds, seed: int) -> Tracked:
        # by its name, so that unlike augmentations with equal generators draw unlike numbers
        draw = generator_of(derived_seed(seed, type(self).__name__))
        if float(torch.rand(1, generator=draw, dtype=torch.float64)) >= self.probability or len(cloud.points) == 0:
            return Tracked(cloud, unmoved(cloud))
        return self.one(cloud, draw)

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """Change one cloud (B = 1, at least one point) by numbers from ``draw``; written by each subclass."""
        raise NotImplementedError

    def extra_repr(self) -> str:
        """The options, for ``repr``."""
        names = inspect.signature(type(self).__init__).parameters
        shown = (name for name in names if name not in ("generator", "members") and hasattr(self, name))
        return ", ".join(f"{name}={getattr(self, name)!r}" for name in shown)


class Compose(Augmentation):
    """Runs augmentations in the order given and records their common motion.

    Args:
        members: to run. A member without a generator draws from seeds of this module, different for each place in the
            order; a member with a generator uses that.
        probability: that a cloud goes through the members at all; each has its own probability besides.
        generator: as for ``Augmentation``.

    Raises:
        ValueError: no member, or one that is no augmentation.

    Example:
        >>> from torchreg.augment import Jitter, RandomMotion
        >>> both = Compose(RandomMotion(), Jitter(), generator=torch.Generator().manual_seed(0))
        >>> both(Clouds(torch.rand(5, 3))).lengths
        [5]
    """

    @checked
    def __init__(
        self, *members: Augmentation, probability: float = 1.0, generator: torch.Generator | None = None
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        expect(len(members) > 0, "members", "at least one augmentation", members)
        for member in members:
            expect(isinstance(member, Augmentation), "members", "augmentations", member)
        self.members = nn.ModuleList(members)

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """Run all members on one cloud."""
        result = Tracked(cloud, unmoved(cloud))
        seed = int(torch.randint(2**62, (1,), generator=draw).item())
        for place, member in enumerate(self.members):
            step = cast(Augmentation, member).tracked(result.clouds, [derived_seed(seed, place)])
            result = Tracked(step.clouds, compose(step.T_new_old, result.T_new_old))
        return result


class AugmentPair(nn.Module):
    """Changes source and target by independent draws, and updates ``T_target_source``.

    With motions A of the source and B of the target, the new truth is B T inverse(A); an unknown truth stays unknown.
    Information matrices are dropped, since they count an overlap that crops and thinning change. Works on one pair
    and on a batch, as ``transform`` of a dataset of pairs or behind a ``DataLoader`` on any device. In evaluation
    mode pairs are returned unchanged. Streams in workers are those of ``Augmentation``.

    Args:
        source: changes sources.
        target: changes targets; ``None``: as the sources, by other draws.
        generator: a CPU generator for those of both that have none; ``None`` makes one with seed 0.

    Raises:
        ValueError: no augmentation, or a generator that is not on the CPU.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=5.0)
        >>> moved = AugmentPair(tr.augment.RandomMotion())(pair)
        >>> torch.equal(moved.T_target_source, pair.T_target_source)
        False
    """

    @checked
    def __init__(
        self, source: Augmentation, target: Augmentation | None = None, *, generator: torch.Generator | None = None
    ) -> None:
        super().__init__()
        target = source if target is None else target
        for name, side in (("source", source), ("target", target)):
            expect(isinstance(side, Augmentation), name, "an augmentation", side)
        self.source, self.target = source, target
        self._stream = SeedStream(generator)

    @entry
    def forward(self, pair: PairType) -> PairType:
        """Change one pair or a batch of pairs; the type stays."""
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


def unmoved(clouds: Clouds) -> Tensor:
    """Identities (B, 4, 4) float64 on the device of the clouds."""
    return torch.eye(4, dtype=torch.float64, device=clouds.device).expand(len(clouds), 4, 4)


def uniform(low: float, high: float, draw: torch.Generator) -> float:
    """Draw a number between ``low`` and ``high``."""
    return low + (high - low) * float(torch.rand(1, generator=draw, dtype=torch.float64))


def checked_range(value: tuple[float, float], name: str, low: float, high: float) -> tuple[float, float]:
    """Return two numbers that ascend within [low, high], else raise ``ValueError``."""
    legal = isinstance(value, (tuple, list)) and len(value) == 2
    legal = legal and all(isinstance(end, (int, float)) and not isinstance(end, bool) for end in value)
    expect(legal and low <= value[0] <= value[1] <= high, name, f"(low, high) within [{low:g}, {high:g}]", value)
    return float(value[0]), float(value[1])


def checked_size(value: float, name: str, unit: str, high: float = float("inf")) -> float:
    """Return a number in [0, high], finite, else raise ``ValueError``."""
    ends = "of at least 0" if high == float("inf") else f"in [0, {high:g}]"
    expect(0 <= value <= high and value < float("inf"), name, f"{unit} {ends}", value)
    finite(value, name)
    return float(value)
