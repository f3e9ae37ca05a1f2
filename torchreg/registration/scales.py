"""One scale for clouds that belong together, so that each of them is described once for all of its pairs.

``register`` takes the lengths of a pair from the coarser of its two clouds. In a batch of all pairs of some scans that
would give every scan as many sets of lengths as it has partners, though they differ by a few percent. So clouds that
pairs link, directly or through others, and whose spacings lie within the factor that ``register`` takes for equal,
share the coarsest spacing among them; a pair then takes the coarser of the two that its clouds share, at most that
factor above what it would take alone. Two clouds that have no other partner keep the spacing of their pair.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from typing import NamedTuple, TypeVar

from torchreg.registration.spacing import MAX_POINTS, UNEVEN, CloudScale
from torchreg.types import Clouds

Key = TypeVar("Key", bound=Hashable)


class Scale(NamedTuple):
    """Meters: the edge of the voxels (0 for none) and the spacing of the points after them."""

    voxel: float
    spacing: float

    @property
    def size(self) -> float:
        """The longer of the two, by which scales are compared."""
        return max(self.voxel, self.spacing)


def scale_of(cloud: Clouds) -> Scale:
    """The scale of one cloud by itself; voxels where it has so many points that ``register`` would thin it."""
    scale = CloudScale(cloud)
    voxel = scale.thinning_voxel if scale.points > MAX_POINTS else 0.0
    return Scale(voxel, scale.spacing(voxel or None))


def coarse_scale_of(cloud: Clouds, points: int) -> Scale:
    """The scale of one cloud thinned to about so many points, where it has more."""
    scale = CloudScale(cloud, points)
    voxel = scale.thinning_voxel
    return Scale(voxel, scale.spacing(voxel or None))


def shared_scales(alone: Mapping[Key, Scale], pairs: Iterable[tuple[Key, Key]]) -> dict[Key, Scale]:
    """The scale that each cloud shares with those that it is linked to; clouds with at most one partner are left out.

    ``alone`` has the scale of every cloud by itself, ``pairs`` the clouds that are registered with each other.
    """
    shared: dict[Key, Scale] = {}
    for linked in _components(alone, pairs):
        rest = sorted(linked, key=lambda cloud: -alone[cloud].size) if len(linked) > 2 else []
        while rest:
            largest = alone[rest[0]].size
            group = [cloud for cloud in rest if alone[cloud].size * UNEVEN >= largest]
            common = Scale(max(alone[cloud].voxel for cloud in group), max(alone[cloud].spacing for cloud in group))
            shared |= dict.fromkeys(group, common)
            rest = rest[len(group) :]
    return shared


def _components(alone: Mapping[Key, Scale], pairs: Iterable[tuple[Key, Key]]) -> list[list[Key]]:
    """Clouds linked by pairs, in the order of ``alone``."""
    leader = {cloud: cloud for cloud in alone}

    def leading(cloud: Key) -> Key:
        while leader[cloud] != cloud:
            leader[cloud] = leader[leader[cloud]]
            cloud = leader[cloud]
        return cloud

    for one, other in pairs:
        leader[leading(other)] = leading(one)
    components: dict[Key, list[Key]] = {}
    for cloud in alone:
        components.setdefault(leading(cloud), []).append(cloud)
    return list(components.values())
