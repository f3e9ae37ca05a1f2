"""From clouds to features, as ``register`` does it: the middle of the pipeline, for both clouds of each pair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchreg.descriptors.color import color_values, joint_color_values
from torchreg.descriptors.contrast import contrast
from torchreg.descriptors.fpfh import fpfh
from torchreg.descriptors.fuse import fuse, rooted
from torchreg.descriptors.learned import shipped_color
from torchreg.descriptors.pcfh import pcfh
from torchreg.errors import expect
from torchreg.neighborhoods import neighbors
from torchreg.preprocess import estimate_normals, voxel_downsample
from torchreg.preprocess.downsample import in_morton_order
from torchreg.types import Clouds, Features, Neighborhoods, RegistrationOptions
from torchreg.types.packing import spans

Options = Sequence[RegistrationOptions]


def downsample(cloud: Clouds, options: Options) -> Clouds:
    """Voxel means where the options of a pair ask for them; all clouds in Z order."""
    if all(option.voxel_size is None for option in options):
        return in_morton_order(cloud)
    parts = [
        in_morton_order(single) if option.voxel_size is None else voxel_downsample(single, option.voxel_size)
        for single, option in zip(cloud.unpack(), options, strict=True)
    ]
    return Clouds.pack(parts)


def oriented(cloud: Clouds, options: Options) -> tuple[Clouds, Neighborhoods]:
    """Clouds with normals, and the neighborhoods that normals and descriptors share."""
    slots = max(max(option.feature_max_neighbors, option.normal_max_neighbors) for option in options)
    near = neighbors(cloud, _lengths(options, _widest), slots)
    normal_near = near.restrict(per_point(cloud, options, lambda o: o.normal_radius), options[0].normal_max_neighbors)
    return estimate_normals(cloud, normal_near), near


_HISTOGRAMS = ("fpfh", "pcfh")  # whose entries are percents; the others are what they are

Described = dict[str, Features]
"""Descriptors of the points of one side by name, not yet scaled or weighed."""


def describe(
    cloud: Clouds, near: Neighborhoods, options: Options, values: Tensor | None, color: Sequence[str]
) -> Described:
    """FPFH and the color blocks named; ``values`` are the hue, saturation and value of every point."""
    first = options[0]
    support = near.restrict(per_point(cloud, options, lambda o: o.feature_radius), first.feature_max_neighbors)
    found = {"fpfh": fpfh(cloud, support)}
    if values is None or not color:
        return found
    radius = per_point(cloud, options, lambda o: o.color_radius)
    color_support = near.restrict(radius)
    for block in color:
        if block == "contrast":
            found[block] = contrast(cloud, color_support, radius)
        elif block == "learned":
            found[block] = shipped_color(cloud, color_support, radius)
        else:
            found[block] = pcfh(
                cloud,
                color_support,
                bins=first.color_bins,
                channels=first.color_channels,
                saturation_weighting=first.saturation_weighting,
                values=values,
            )
    return found


def fused(described: Described, color: Sequence[str], weights: Sequence[float], root: float = 0.0) -> Features:
    """FPFH and these color blocks with these weights beside FPFH's 1, as one vector; histograms rooted so far."""
    blocks = [
        replace(described[name], values=rooted(described[name].values, root))
        if root > 0 and name in _HISTOGRAMS
        else described[name]
        for name in ("fpfh", *color)
    ]
    return fuse(*blocks, weights=(1.0, *weights))


def color_of_pairs(source: Clouds, target: Clouds, options: Options) -> tuple[Tensor, Tensor] | tuple[None, None]:
    """Hue, saturation and value of both sides, equalized as asked; nothing where no color is to be used."""
    first = options[0]
    if not first.color or source.colors is None or target.colors is None:
        return None, None
    if first.equalization == "joint":
        return joint_color_values(source, target)
    return color_values(source, first.equalization), color_values(target, first.equalization)


def per_point(cloud: Clouds, options: Options, read: Callable[[RegistrationOptions], float]) -> float | Tensor:
    """A length as one number where all pairs agree, else one per point (P,)."""
    values = _lengths(options, read)
    if bool((values == values[0]).all()):
        return float(values[0])
    counts = torch.tensor([end - begin for begin, end in spans(cloud.offsets)])
    return values.repeat_interleave(counts).to(cloud.device)


def expect_alike(options: Options) -> None:
    """Raise ``ValueError`` where options of one batch differ in more than lengths."""
    for option in options[1:]:
        alike = without_lengths(option) == without_lengths(options[0])
        expect(alike, "options", "options that differ in lengths only within one batch", option)


def without_lengths(options: RegistrationOptions) -> RegistrationOptions:
    """The options with every length at one meter: what pairs of one batch must share."""
    return replace(
        options,
        voxel_size=None,
        normal_radius=1.0,
        feature_radius=1.0,
        color_radius=1.0,
        ransac=replace(options.ransac, inlier_threshold=1.0),
    )


def _widest(options: RegistrationOptions) -> float:
    color = options.color_radius if options.color else 0.0
    return max(options.normal_radius, options.feature_radius, color)


def _lengths(options: Options, read: Callable[[RegistrationOptions], float]) -> Tensor:
    return torch.tensor([read(option) for option in options], dtype=torch.float64)
