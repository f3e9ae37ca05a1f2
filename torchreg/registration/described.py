"""Clouds made ready to be matched: thinned, with normals and descriptors. What a pair needs of each of its sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchreg.errors import expect
from torchreg.registration.inspect import CloudFacts
from torchreg.types import Clouds, Features
from torchreg.types.packing import offsets_of, spans


@dataclass(frozen=True, eq=False)
class DescribedClouds:
    """B clouds as ``register`` matches them, made by ``describe_clouds``.

    Attributes:
        cloud: downsampled, in Z order, with normals.
        descriptors: of its points by name ("fpfh", "contrast", "pcfh"), not yet scaled or weighed; all have the
            offsets of ``cloud``.
        spacing: B numbers, meters, the median distance to the fourth nearest other point.
        facts: of the B clouds as they were given.
    """

    cloud: Clouds
    descriptors: dict[str, Features]
    spacing: tuple[float, ...]
    facts: tuple[CloudFacts, ...]

    def __post_init__(self) -> None:
        for name in ("spacing", "facts"):
            count = len(getattr(self, name))
            expect(count == len(self.cloud), name, f"one per cloud ({len(self.cloud)})", count)
        for name, features in self.descriptors.items():
            fits = torch.equal(features.offsets, self.cloud.offsets)
            expect(fits, f"descriptors[{name!r}]", "the offsets of the cloud", features.offsets)

    def __len__(self) -> int:
        """The number of clouds, B."""
        return len(self.cloud)

    @staticmethod
    def pack(parts: Sequence[DescribedClouds]) -> DescribedClouds:
        """Join batches into one; all must have the same descriptors.

        Raises:
            ValueError: nothing to pack, or other descriptors in one part than in another.
        """
        expect(len(parts) > 0, "parts", "at least one", parts)
        names = list(parts[0].descriptors)
        for part in parts:
            expect(list(part.descriptors) == names, "descriptors", f"{names} in all parts", list(part.descriptors))
        if len(parts) == 1:
            return parts[0]
        cloud = Clouds.pack([part.cloud for part in parts])
        return DescribedClouds(
            cloud=cloud,
            descriptors={name: _joined([part.descriptors[name] for part in parts], cloud) for name in names},
            spacing=tuple(apart for part in parts for apart in part.spacing),
            facts=tuple(facts for part in parts for facts in part.facts),
        )

    def unpack(self) -> list[DescribedClouds]:
        """The clouds as batches of one; their tensors are views."""
        return [
            DescribedClouds(
                cloud=cloud,
                descriptors={name: _part(item, begin, end) for name, item in self.descriptors.items()},
                spacing=self.spacing[b : b + 1],
                facts=self.facts[b : b + 1],
            )
            for b, (cloud, (begin, end)) in enumerate(zip(self.cloud.unpack(), spans(self.cloud.offsets), strict=True))
        ]

    def emptied(self) -> DescribedClouds:
        """The same clouds without points: what takes the place of a pair that is refused."""
        none, offsets = (
            torch.zeros(0, dtype=torch.int64, device=self.cloud.device),
            torch.zeros_like(self.cloud.offsets),
        )
        return replace(
            self,
            cloud=self.cloud.rows(none, offsets),
            descriptors={
                name: replace(item, values=item.values[:0], valid=item.valid[:0], offsets=offsets)
                for name, item in self.descriptors.items()
            },
        )

    def clone(self) -> DescribedClouds:
        """A copy in memory of its own."""
        cloud = self.cloud
        return replace(
            self,
            cloud=replace(
                cloud,
                points=cloud.points.clone(),
                colors=None if cloud.colors is None else cloud.colors.clone(),
                normals=None if cloud.normals is None else cloud.normals.clone(),
            ),
            descriptors={
                name: replace(item, values=item.values.clone(), valid=item.valid.clone())
                for name, item in self.descriptors.items()
            },
        )

    def to(self, device: torch.device | str) -> DescribedClouds:
        """Copy to a device."""
        return replace(
            self,
            cloud=self.cloud.to(device),
            descriptors={
                name: replace(item, values=item.values.to(device), valid=item.valid.to(device))
                for name, item in self.descriptors.items()
            },
        )


def _part(features: Features, begin: int, end: int) -> Features:
    return replace(
        features, values=features.values[begin:end], valid=features.valid[begin:end], offsets=offsets_of([end - begin])
    )


def _joined(parts: Sequence[Features], cloud: Clouds) -> Features:
    return replace(
        parts[0],
        values=torch.cat([part.values for part in parts]),
        valid=torch.cat([part.valid for part in parts]),
        offsets=cloud.offsets,
    )
