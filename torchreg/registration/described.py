"""Described clouds: thinned, with normals and descriptors. What matching a pair needs of each of its sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import torch
from torch import Tensor

from torchreg.descriptors.descriptor import Descriptor
from torchreg.errors import expect
from torchreg.registration.inspect import CloudFacts
from torchreg.types import Clouds, Features
from torchreg.types.lengths import without_lengths
from torchreg.types.packing import kept_rows, spans


@dataclass(frozen=True, eq=False)
class DescribedClouds:
    """B clouds as ``register`` matches them, made by ``describe_clouds``.

    Attributes:
        cloud: downsampled, in Z order, with normals.
        features: of every descriptor, not yet scaled or weighed; all have the offsets of ``cloud``.
        descriptors: of every cloud the records that described it, in the order of ``features``.
        spacing: B numbers, meters, the median distance to the fourth nearest other point.
        facts: of the B clouds as they were given.
    """

    cloud: Clouds
    features: tuple[Features, ...]
    descriptors: tuple[tuple[Descriptor, ...], ...]
    spacing: tuple[float, ...]
    facts: tuple[CloudFacts, ...]

    def __post_init__(self) -> None:
        for name in ("descriptors", "spacing", "facts"):
            count = len(getattr(self, name))
            expect(count == len(self.cloud), name, f"one per cloud ({len(self.cloud)})", count)
        for features in self.features:
            expect(torch.equal(features.offsets, self.cloud.offsets), "features", "the offsets of the cloud", features)
        for records in self.descriptors:
            expect(len(records) == len(self.features), "descriptors", f"one per block ({len(self.features)})", records)

    def __len__(self) -> int:
        """The number of clouds, B."""
        return len(self.cloud)

    @staticmethod
    def pack(parts: Sequence[DescribedClouds]) -> DescribedClouds:
        """Join batches into one; all must have the same descriptors, but for their lengths.

        Raises:
            ValueError: nothing to pack, or other descriptors in one part than in another.
        """
        expect(len(parts) > 0, "parts", "at least one", parts)
        if len(parts) == 1:
            return parts[0]
        kinds = {tuple(map(without_lengths, records)) for part in parts for records in part.descriptors}
        expect(len(kinds) <= 1, "parts", "the same descriptors in all", kinds)
        cloud = Clouds.pack([part.cloud for part in parts])
        features = []
        for blocks in zip(*(part.features for part in parts), strict=True):
            values, valid = torch.cat([block.values for block in blocks]), torch.cat([block.valid for block in blocks])
            features.append(Features(values, cloud.offsets, blocks[0].blocks, valid))
        return DescribedClouds(
            cloud=cloud,
            features=tuple(features),
            descriptors=tuple(records for part in parts for records in part.descriptors),
            spacing=tuple(spacing for part in parts for spacing in part.spacing),
            facts=tuple(facts for part in parts for facts in part.facts),
        )

    def unpack(self) -> list[DescribedClouds]:
        """The clouds as batches of one; their tensors are views."""
        return [
            DescribedClouds(
                cloud=cloud,
                features=self._features(cloud.offsets, itemgetter(slice(begin, end))),
                descriptors=self.descriptors[b : b + 1],
                spacing=self.spacing[b : b + 1],
                facts=self.facts[b : b + 1],
            )
            for b, (cloud, (begin, end)) in enumerate(zip(self.cloud.unpack(), spans(self.cloud.offsets), strict=True))
        ]

    def without(self, refused: Sequence[object]) -> DescribedClouds:
        """The same clouds, those of refused pairs without points, so that they do not affect the others."""
        if not any(refused):
            return self
        index, offsets = kept_rows(self.cloud.offsets, refused)
        index = index.to(self.cloud.device)
        cloud = self.cloud.rows(index, offsets)
        return replace(self, cloud=cloud, features=self._features(offsets, lambda rows: rows[index]))

    def clone(self) -> DescribedClouds:
        """A copy in memory of its own."""
        cloud = Clouds.pack([self.cloud])  # which copies
        return replace(self, cloud=cloud, features=self._features(cloud.offsets, Tensor.clone))

    def to(self, device: torch.device | str) -> DescribedClouds:
        """Copy to a device."""
        cloud = self.cloud.to(device)
        return replace(self, cloud=cloud, features=self._features(cloud.offsets, lambda rows: rows.to(device)))

    def _features(self, offsets: Tensor, change: Callable[[Tensor], Tensor]) -> tuple[Features, ...]:
        """The features with every tensor of rows changed by a function."""
        return tuple(
            Features(change(block.values), offsets, block.blocks, change(block.valid)) for block in self.features
        )
