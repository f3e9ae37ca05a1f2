"""One scale for clouds that belong together, so that each of them is described once for all of its pairs.

``register`` takes the lengths of a pair from the coarser of its two clouds. In a batch of all pairs of some scans that
would give every scan as many sets of lengths as it has partners, though they differ by a few percent. So clouds that
pairs link, directly or through others, and whose spacings lie within the factor that ``register`` takes for equal,
share the coarsest spacing among them; a pair then takes the coarser of its clouds' shared ones. For a pair that
shares no cloud with another one, these are the lengths of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple, TypeVar

from torchreg.registration.scale import UNEVEN, scaled_options
from torchreg.types import RegistrationOptions

Key = TypeVar("Key")


class Scale(NamedTuple):
    """Meters: the edge of the voxels (0 for none) and the spacing of the points after them."""

    voxel: float
    spacing: float

    @property
    def size(self) -> float:
        """What scales are compared by."""
        return max(self.voxel, self.spacing)


def shared_scales(
    own: Mapping[Key, Scale], pairs: Iterable[tuple[Key, Key]], kept: Mapping[Key, Scale] | None = None
) -> dict[Key, Scale]:
    """The scale of every cloud together with those that it belongs to.

    Args:
        own: of every cloud by itself.
        pairs: the clouds that are registered with each other.
        kept: shared scales found before, which stay; others join them where they fit.
    """
    kept = {} if kept is None else kept
    shared: dict[Key, Scale] = {}
    for linked in _components(own, pairs):
        shared |= {cloud: kept[cloud] for cloud in linked if cloud in kept}
        present = list(dict.fromkeys(shared[cloud] for cloud in linked if cloud in kept))
        rest = sorted((cloud for cloud in linked if cloud not in kept), key=lambda cloud: -own[cloud].size)
        while rest:
            first = own[rest[0]].size
            fitting = [scale for scale in present if first <= scale.size <= UNEVEN * first]
            largest = fitting[0].size if fitting else first
            group = [cloud for cloud in rest if own[cloud].size * UNEVEN >= largest]
            common = Scale(max(own[cloud].voxel for cloud in group), max(own[cloud].spacing for cloud in group))
            shared |= dict.fromkeys(group, fitting[0] if fitting else common)
            rest = rest[len(group) :]
    return shared


def options_of(source: Scale, target: Scale, *, colored: bool) -> RegistrationOptions:
    """The options of a pair, as ``derive_options`` makes them from the scales of its clouds."""
    spacing, voxel = max(source.spacing, target.spacing), max(source.voxel, target.voxel)
    least = min(source.spacing, target.spacing)
    if voxel == 0 and 0 < UNEVEN * least < spacing:
        voxel = spacing
    return scaled_options(spacing if spacing > 0 else 1.0, voxel_size=voxel if voxel > 0 else None, colored=colored)


def _components(own: Mapping[Key, Scale], pairs: Iterable[tuple[Key, Key]]) -> list[list[Key]]:
    """Clouds linked by pairs, in the order of ``own``."""
    leader = {cloud: cloud for cloud in own}

    def leading(cloud: Key) -> Key:
        while leader[cloud] != cloud:
            leader[cloud] = leader[leader[cloud]]
            cloud = leader[cloud]
        return cloud

    for one, other in pairs:
        leader[leading(other)] = leading(one)
    found: dict[Key, list[Key]] = {}
    for cloud in own:
        found.setdefault(leading(cloud), []).append(cloud)
    return list(found.values())
