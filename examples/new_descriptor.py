"""Adds a descriptor: a record with a name, a radius and `describe`, which takes part like those of the library.

Search, batches, caching, fusion and clouds without colors follow from the record.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import torch

import torchreg as tr


@dataclass(frozen=True, kw_only=True)
class Spread(tr.Descriptor):
    """How far a neighborhood reaches along its three main directions: 3 numbers, the same after any motion."""

    name: ClassVar[str] = "spread"

    def describe(self, cloud: tr.Clouds, near: tr.Neighborhoods) -> tr.Features:
        """One row for every point, from its neighbors within `self.radius`."""
        around = torch.where(near.valid[..., None], cloud.points[near.index] - cloud.points[:, None], 0)  # (P, K, 3)
        count = near.counts()
        moments = around.mT @ around / count.clamp(min=1)[:, None, None]  # (P, 3, 3)
        spread = torch.linalg.eigvalsh(moments).clamp(min=0).sqrt() / self.radius  # (P, 3)
        valid = count > 3  # rows of other points are zero, and are not matched
        return tr.Features(spread * valid[:, None], cloud.offsets, blocks=((self.name, 3),), valid=valid)


hall = tr.datasets.mall(seed=1, angular_step=1.2)
options = tr.derive_options(hall.source, hall.target)[0]  # what register would take
mine = Spread(radius=options.descriptors[0].radius)
options = replace(options, descriptors=(*options.descriptors, mine), weights=(*options.weights, 0.3))
result = tr.register(hall.source, hall.target, options)
print(result.explain())
