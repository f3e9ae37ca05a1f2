"""Clouds made ready to be matched: thinned, with normals and descriptors. What a pair needs of each of its sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchreg.descriptors.descriptor import Descriptor
from torchreg.errors import expect
from torchreg.registration.inspect import CloudFacts
from torchreg.types import Clouds, Features
from torchreg.types.lengths import without_lengths
from torchreg.types.packing import offsets_of, spans


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
        return DescribedClouds(
            cloud=cloud,
            features=tuple(
                replace(
                    blocks[0],
                    values=torch.cat([block.values for block in blocks]),
                    valid=torch.cat([block.valid for block in blocks]),
                    offsets=cloud.offsets,
                )
                for blocks in zip(*(part.features for part in parts), strict=True)
            ),
            descriptors=tuple(records for part in parts for records in part.descriptors),
            spacing=tuple(spacing for part in parts for spacing in part.spacing),
            facts=tuple(facts for part in parts for facts in part.facts),
        )

    def unpack(self) -> list[DescribedClouds]:
        """The clouds as batches of one; their tensors are views."""
        return [
            DescribedClouds(
                cloud=cloud,
                features=tuple(
                    replace(
                        block,
                        values=block.values[begin:end],
                        valid=block.valid[begin:end],
                        offsets=offsets_of([end - begin]),
                    )
                    for block in self.features
                ),
                descriptors=self.descriptors[b : b + 1],
                spacing=self.spacing[b : b + 1],
                facts=self.facts[b : b + 1],
            )
            for b, (cloud, (begin, end)) in enumerate(zip(self.cloud.unpack(), spans(self.cloud.offsets), strict=True))
        ]

    def emptied(self) -> DescribedClouds:
        """The same clouds without points: what takes the place of a pair that is refused."""
        return self._mapped(lambda rows: rows[:0], offsets=torch.zeros_like(self.cloud.offsets))

    def clone(self) -> DescribedClouds:
        """A copy in memory of its own."""
        return self._mapped(Tensor.clone)

    def to(self, device: torch.device | str) -> DescribedClouds:
        """Copy to a device."""
        moved = self._mapped(lambda rows: rows.to(device))
        return replace(moved, cloud=self.cloud.to(device))

    def _mapped(self, change: Callable[[Tensor], Tensor], offsets: Tensor | None = None) -> DescribedClouds:
        """With every tensor of rows changed by a function."""
        cloud, offsets = self.cloud, self.cloud.offsets if offsets is None else offsets
        return replace(
            self,
            cloud=replace(
                cloud,
                points=change(cloud.points),
                offsets=offsets,
                colors=None if cloud.colors is None else change(cloud.colors),
                normals=None if cloud.normals is None else change(cloud.normals),
            ),
            features=tuple(
                replace(block, values=change(block.values), valid=change(block.valid), offsets=offsets)
                for block in self.features
            ),
        )
