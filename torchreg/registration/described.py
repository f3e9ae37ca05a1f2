"""Described clouds: thinned, with normals and descriptors. What matching a pair needs of each of its sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import torch
from torch import Tensor

from torchreg.descriptors.descriptor import Descriptor
from torchreg.errors import expect, expect_in_words, expect_shape
from torchreg.keypoints.keypoints import Keypoints, KeypointSupport
from torchreg.refinement.surfels import Surfels
from torchreg.registration.inspect import CloudFacts
from torchreg.types import Clouds, Features
from torchreg.types.lengths import besides_lengths, length
from torchreg.types.packing import kept_rows, spans


@dataclass(frozen=True, kw_only=True)
class Description:
    """What one cloud is described with: equal ones give equal clouds the same description."""

    voxel_size: float | None = length(None)  # meters, as in ``RegistrationOptions``
    normal_radius: float = length()  # meters
    normal_max_neighbors: int
    descriptors: tuple[Descriptor, ...]  # in the order of the features
    refine: str = "none"  # as in ``RegistrationOptions``
    refine_points: int = 0  # as there; 0 beside "none"
    keypoints: Keypoints | None = None  # as there

    @property
    def max_neighbors(self) -> int:
        """The slots of the one search that serves normals and descriptors."""
        least = 1 if self._support is None else self._support.max_neighbors
        return max([least, self.normal_max_neighbors, *(record.max_neighbors for record in self.descriptors)])

    @property
    def widest(self) -> float:
        """Meters, the radius of that search."""
        least = 0.0 if self._support is None else self._support.radius
        return max([least, self.normal_radius, *(record.radius for record in self.descriptors)])

    @property
    def is_pairwise(self) -> bool:
        """Whether some descriptor looks at both clouds of a pair."""
        return any(record.is_pairwise for record in self.descriptors)

    @property
    def _support(self) -> KeypointSupport | None:
        return None if self.keypoints is None else self.keypoints.support


@dataclass(frozen=True, eq=False)
class DescribedClouds:
    """B clouds as ``register`` matches them, made by ``describe_clouds``.

    Attributes:
        cloud: downsampled, in Z order, with normals.
        features: of every descriptor, not yet scaled or weighed; all have the offsets of ``cloud``.
        descriptions: of every cloud what it was described with, its descriptors in the order of ``features``.
        spacing: B numbers, meters, the median distance to the fourth nearest other point.
        facts: of the B clouds as they were given.
        surfels: of the B clouds, to refine poses on; ``None`` where poses are not refined.
        outside: features from elsewhere that the clouds are matched by in place of ``features``, which then judge poses
            alone; ``None`` where there are none. They have the offsets of ``cloud``.
        keypoints: (P,) bool, the points that are matched; ``None`` where all are.
    """

    cloud: Clouds
    features: tuple[Features, ...]
    descriptions: tuple[Description, ...]
    spacing: tuple[float, ...]
    facts: tuple[CloudFacts, ...]
    surfels: Surfels | None = None
    outside: Features | None = None
    keypoints: Tensor | None = None

    def __post_init__(self) -> None:
        for name in ("descriptions", "spacing", "facts"):
            count = len(getattr(self, name))
            expect(count == len(self.cloud), name, f"one per cloud ({len(self.cloud)})", count)
        for features in (*self.features, *self._of_outside()):
            expect(torch.equal(features.offsets, self.cloud.offsets), "features", "the offsets of the cloud", features)
        for description in self.descriptions:
            fits = len(description.descriptors) == len(self.features)
            expect(fits, "descriptions", f"a descriptor per block ({len(self.features)})", description)
        if self.keypoints is not None:
            expect_shape(self.keypoints, "keypoints", (len(self.cloud.points),), torch.bool)

    def __len__(self) -> int:
        """The number of clouds, B."""
        return len(self.cloud)

    @staticmethod
    def pack(parts: Sequence[DescribedClouds]) -> DescribedClouds:
        """Join batches into one; all must have the same descriptions, but for their lengths.

        Raises:
            ValueError: nothing to pack, or other descriptions in one part than in another.
        """
        expect(len(parts) > 0, "parts", "at least one", parts)
        if len(parts) == 1:
            return parts[0]
        kinds = {besides_lengths(description) for part in parts for description in part.descriptions}
        expect(len(kinds) <= 1, "parts", "the same descriptors in all", kinds)
        cloud = Clouds.pack([part.cloud for part in parts])
        features = zip(*(part.features for part in parts), strict=True)
        outside = list(zip(*(part._of_outside() for part in parts), strict=True))
        return DescribedClouds(
            cloud=cloud,
            features=tuple(_joined(blocks, cloud.offsets) for blocks in features),
            descriptions=tuple(description for part in parts for description in part.descriptions),
            spacing=tuple(spacing for part in parts for spacing in part.spacing),
            facts=tuple(facts for part in parts for facts in part.facts),
            surfels=_packed([part.surfels for part in parts]),
            outside=_joined(outside[0], cloud.offsets) if outside else None,
            keypoints=_concatenated([part.keypoints for part in parts]),
        )

    def unpack(self) -> list[DescribedClouds]:
        """The clouds as batches of one; their tensors are views."""
        surfels = [None] * len(self) if self.surfels is None else self.surfels.unpack()
        return [
            DescribedClouds(
                cloud=cloud,
                **self._features(cloud.offsets, itemgetter(slice(begin, end))),
                descriptions=self.descriptions[b : b + 1],
                spacing=self.spacing[b : b + 1],
                facts=self.facts[b : b + 1],
                surfels=surfels[b],
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
        surfels = None if self.surfels is None else self.surfels.without(refused)
        return replace(self, cloud=cloud, **self._features(offsets, lambda rows: rows[index]), surfels=surfels)

    def clone(self) -> DescribedClouds:
        """A copy in memory of its own."""
        cloud = Clouds.pack([self.cloud])  # which copies
        surfels = None if self.surfels is None else Surfels.pack([self.surfels])
        return replace(self, cloud=cloud, **self._features(cloud.offsets, Tensor.clone), surfels=surfels)

    def to(self, device: torch.device | str) -> DescribedClouds:
        """Copy to a device."""
        cloud = self.cloud.to(device)
        surfels = None if self.surfels is None else self.surfels.to(device)
        features = self._features(cloud.offsets, lambda rows: rows.to(device))
        return replace(self, cloud=cloud, **features, surfels=surfels)

    def _features(self, offsets: Tensor, change: Callable[[Tensor], Tensor]) -> dict[str, Any]:
        """The fields of features and keypoints with every tensor of rows changed by a function."""

        def changed(block: Features) -> Features:
            return Features(change(block.values), offsets, block.blocks, change(block.valid))

        outside = None if self.outside is None else changed(self.outside)
        keypoints = None if self.keypoints is None else change(self.keypoints)
        return {"features": tuple(map(changed, self.features)), "outside": outside, "keypoints": keypoints}

    def matched(self, features: Features) -> Features:
        """Features of all points with those alone valid that are matched."""
        return features if self.keypoints is None else replace(features, valid=features.valid & self.keypoints)

    def _of_outside(self) -> tuple[Features, ...]:
        """The features from elsewhere, where there are some."""
        return () if self.outside is None else (self.outside,)


def _joined(parts: Sequence[Features], offsets: Tensor) -> Features:
    """Features of one kind, those of several batches one after another; a batch without rows may have any width."""
    parts = [part for part in parts if len(part.values) > 0] or parts[:1]
    values, valid = torch.cat([part.values for part in parts]), torch.cat([part.valid for part in parts])
    return Features(values, offsets, parts[0].blocks, valid)


def _concatenated(parts: Sequence[Tensor | None]) -> Tensor | None:
    """The keypoints of all parts, which have the same descriptions; ``None`` where they have none."""
    there = [part for part in parts if part is not None]
    expect(len(there) in (0, len(parts)), "parts", "keypoints in all of them or in none", f"in {len(there)}")
    return torch.cat(there) if there else None


def _packed(parts: Sequence[Surfels | None]) -> Surfels | None:
    """The surfels of all parts, which have the same descriptions; ``None`` where they have none."""
    there = [part for part in parts if part is not None]
    expect_in_words(len(there) in (0, len(parts)), "parts", "surfels in all of them or in none", f"in {len(there)}")
    return Surfels.pack(there) if there else None
