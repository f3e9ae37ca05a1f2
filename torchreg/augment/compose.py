"""Several augmentations one after another."""

from __future__ import annotations

from typing import cast

import torch
from torch import nn

from torchreg.augment.augmentation import Augmentation, Tracked, unmoved
from torchreg.augment.streams import derived_seed
from torchreg.errors import expect
from torchreg.geometry.se3 import compose
from torchreg.types import Clouds


class Compose(Augmentation):
    """Runs augmentations in the order given, and records the motion that all of them make together.

    Args:
        members: what to run. A member without a generator of its own draws from seeds of this module, different for
            each place in the order; one with a generator keeps to it.
        probability: that a cloud goes through the members at all; each has its own probability besides.
        generator: as for ``Augmentation``.

    Raises:
        ValueError: no member, or something else than an augmentation.

    Example:
        >>> from torchreg.augment import Jitter, RandomMotion
        >>> both = Compose(RandomMotion(), Jitter(), generator=torch.Generator().manual_seed(0))
        >>> both(Clouds(torch.rand(5, 3))).lengths
        [5]
    """

    def __init__(
        self, *members: Augmentation, probability: float = 1.0, generator: torch.Generator | None = None
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        expect(len(members) > 0, "members", "at least one augmentation", members)
        for member in members:
            expect(isinstance(member, Augmentation), "members", "augmentations", member)
        self.members = nn.ModuleList(members)

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """The cloud after all members."""
        done = Tracked(cloud, unmoved(cloud))
        seed = int(torch.randint(2**62, (1,), generator=draw).item())
        for place, member in enumerate(self.members):
            step = cast(Augmentation, member).tracked(done.clouds, [derived_seed(seed, place)])
            done = Tracked(step.clouds, compose(step.T_new_old, done.T_new_old))
        return done
