"""From clouds to what ``register`` matches, every cloud by itself: thinned, oriented, described.

What comes out of a cloud depends on the cloud and on the lengths of its options alone (but for jointly equalized
hue), so a cloud that stands in many pairs is described once, and may be kept for later.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchreg.descriptors.color import color_values, joint_color_values
from torchreg.errors import expect
from torchreg.registration.describe import Options, describe, downsample, expect_alike, oriented
from torchreg.registration.described import DescribedClouds
from torchreg.registration.inspect import facts_of, set_aside, too_wide
from torchreg.registration.presets import PAPER
from torchreg.registration.recipes import blocks_of, recipes_of
from torchreg.registration.spacings import spacings_of
from torchreg.registration.stopwatch import Stopwatch
from torchreg.solvers import one_per_pair
from torchreg.types import Clouds, RegistrationOptions

_SLOT_BYTES = 32  # of a neighborhood's slot: index, distance and masks, of the search and of what restricts it


def describe_clouds(
    clouds: Clouds, options: RegistrationOptions | Sequence[RegistrationOptions], *, max_bytes: int = 1 << 28
) -> DescribedClouds:
    """Describe clouds for later calls of ``register_described``.

    Args:
        clouds: B clouds.
        options: for all of them or one per cloud (which then differ in lengths only), as the pairs will have them.
        max_bytes: bounds the neighborhoods that are held at once; one cloud's are held in any case. The result does
            not depend on it.

    Returns:
        DescribedClouds. A cloud that cannot be registered keeps its facts and has no points. No gradients.

    Raises:
        ValueError: options that differ in more than lengths, or that equalize hue jointly over a pair.
    """
    per_cloud = one_per_pair(PAPER if options is None else options, len(clouds))
    expect_alike(per_cloud)
    first = per_cloud[0]
    joint = first.equalization == "joint" and "pcfh" in first.color and clouds.colors is not None
    expect(not joint, "options", "an equalization of each cloud by itself", first.equalization)
    blocks = blocks_of(recipes_of(first, clouds.colors is not None))
    facts = facts_of(clouds)
    defects = [one.defect or too_wide(one, option.voxel_size) for one, option in zip(facts, per_cloud, strict=True)]
    thin = downsample(set_aside(clouds.detach(), defects), per_cloud)
    per_cloud = [description_options(option, blocks) for option in per_cloud]
    found = describe_thin(thin, per_cloud, blocks, Stopwatch(), max_bytes=max_bytes)
    return replace(found, facts=facts)


def description_options(options: RegistrationOptions, blocks: Sequence[str]) -> RegistrationOptions:
    """The options with everything that leaves descriptions as they are set to one value: equal ones describe alike."""
    color: dict[str, Any] = {"color_radius": options.color_radius} if blocks else {}
    histograms: dict[str, Any] = {
        "color_bins": options.color_bins,
        "color_channels": options.color_channels,
        "equalization": options.equalization,
        "saturation_weighting": options.saturation_weighting,
    }
    return replace(
        RegistrationOptions(),
        voxel_size=options.voxel_size,
        normal_radius=options.normal_radius,
        normal_max_neighbors=options.normal_max_neighbors,
        feature_radius=options.feature_radius,
        feature_max_neighbors=options.feature_max_neighbors,
        color=tuple(blocks),
        color_weights=(1.0,) * len(blocks),
        **color,
        **(histograms if "pcfh" in blocks else {}),
    )


def describe_thin(
    clouds: Clouds, options: Options, blocks: Sequence[str], watch: Stopwatch, *, max_bytes: int, joint: bool = False
) -> DescribedClouds:
    """Describe clouds that are downsampled already, with the facts of what came; arguments as ``describe_clouds``'.

    ``blocks`` are the color blocks; ``joint``: clouds 2 i and 2 i + 1 share one map of hue.
    """
    slots = max(max(option.feature_max_neighbors, option.normal_max_neighbors) for option in options)
    parts = []
    for group in _groups(clouds.lengths, max(1, max_bytes // (_SLOT_BYTES * slots)), 2 if joint else 1):
        chosen = [options[b] for b in group]
        cloud, near = oriented(clouds.select(group), chosen)
        watch.lap("neighbors and normals")
        values = _color_values(cloud, chosen[0], joint) if blocks else None
        parts.append(
            DescribedClouds(
                cloud=cloud,
                descriptors=describe(cloud, near, chosen, values, blocks),
                spacing=tuple(spacings_of(cloud, near)),
                facts=facts_of(cloud),
            )
        )
        watch.lap("descriptors")
    return DescribedClouds.pack(parts)


def _groups(lengths: Sequence[int], points: int, step: int) -> Iterator[list[int]]:
    """Clouds in order, ``step`` of them kept together, in groups of at most so many points where that can be."""
    group: list[int] = []
    held = 0
    for begin in range(0, len(lengths), step):
        own = list(range(begin, begin + step))
        size = sum(lengths[b] for b in own)
        if group and held + size > points:
            yield group
            group, held = [], 0
        group, held = group + own, held + size
    if group:
        yield group


def _color_values(cloud: Clouds, options: RegistrationOptions, joint: bool) -> Tensor | None:
    """Hue, saturation and value (P, 3) of the clouds, equalized as asked; nothing where they have no colors."""
    if cloud.colors is None:
        return None
    if not joint:
        return color_values(cloud, options.equalization)
    pairs = range(0, len(cloud), 2)
    sides = joint_color_values(cloud.select(list(pairs)), cloud.select([b + 1 for b in pairs]))
    cuts = [side.split(cloud.lengths[k::2]) for k, side in enumerate(sides)]
    return torch.cat([part for both in zip(*cuts, strict=True) for part in both])
