"""From clouds to described clouds: thinned, with normals and descriptors, as ``register`` matches them.

    downsample -> neighbors -> estimate_normals -> describe

The result depends on the cloud and its ``Description`` alone (where no descriptor is pairwise), so a cloud that stands
in many pairs is described once, and may be kept for later.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchreg.descriptors.descriptor import Descriptor, largest_entries
from torchreg.entry import entry
from torchreg.errors import expect, expect_in_words, expect_shape
from torchreg.geometry.numerics.partition import partition
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.keypoints.keypoints import KeypointRows, Keypoints, marked
from torchreg.neighborhoods.search import neighbors
from torchreg.preprocess.downsample import in_morton_order, voxel_downsample
from torchreg.preprocess.normals import estimate_normals
from torchreg.preprocess.orientation import orient_like
from torchreg.refinement.surfels import Surfels, surfels_of
from torchreg.registration.described import DescribedClouds, Description
from torchreg.registration.inspect import facts_of, set_aside, too_wide
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.stopwatch import stage
from torchreg.registration.tiles import reach_of, tiles_of
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.lengths import besides_lengths
from torchreg.types.packing import offsets_of, spans

_SLOT_BYTES = 32  # of a neighborhood's slot: index, distance and masks, of the search and of what restricts it
_SPACING_NEIGHBOR = 4
_LEAST_TILE = 20_000  # points of a tile, however little memory is granted: smaller ones are mostly margin


def description_of(options: RegistrationOptions, *, colored: bool) -> Description:
    """What the options describe a cloud with; without colors the descriptors that need none.

    Raises:
        ValueError: no descriptor is left without colors.
    """
    records = tuple(record for record in options.descriptors if colored or not record.needs_colors)
    expect(len(records) > 0, "options.descriptors", "one that needs no colors, for clouds without", options.descriptors)
    return replace(_description(options), descriptors=records)


def _description(options: RegistrationOptions) -> Description:
    """All but the descriptors, which it has none of."""
    return Description(
        voxel_size=options.voxel_size,
        normal_radius=options.normal_radius,
        normal_max_neighbors=options.normal_max_neighbors,
        descriptors=(),
        refine=options.refine,
        refine_points=0 if options.refine == "none" else options.refine_points,
        keypoints=options.keypoints,
    )


def judging_description(options: RegistrationOptions, *, colored: bool, always: bool = False) -> Description:
    """What the options describe a cloud with where it is matched by something else: what poses are judged by, alone.

    That is the first descriptor of geometry and the first of color, of each cloud by itself; none where the effort is
    plain, which judges no pose, unless they are ``always`` wanted.
    """
    first: dict[bool, Descriptor] = {}
    for record in options.descriptors if always or options.effort != "plain" else ():
        if not record.is_pairwise and (colored or not record.needs_colors):
            first.setdefault(record.needs_colors, record)
    kept = tuple(record for record in options.descriptors if any(record is each for each in first.values()))
    return replace(_description(options), descriptors=kept)


@entry
def describe_clouds(
    clouds: Clouds, options: RegistrationOptions | Sequence[RegistrationOptions], *, max_bytes: int = 1 << 28
) -> DescribedClouds:
    """Describe clouds for later calls of ``register_described``.

    Args:
        clouds: B clouds.
        options: for all of them or one per cloud (which then differ in lengths only), as the pairs will have them.
        max_bytes: bounds the neighborhoods in memory at once, but for those of one cloud. The result does not depend
            on it.

    Returns:
        DescribedClouds. A cloud that cannot be registered keeps its facts and has no points. No gradients.

    Raises:
        ValueError: options that differ in more than lengths, or a descriptor that looks at both clouds of a pair.
    """
    per_cloud = [options] * len(clouds) if isinstance(options, RegistrationOptions) else list(options)
    expect(len(per_cloud) == len(clouds), "options", f"one for all or one per cloud ({len(clouds)})", len(per_cloud))
    colored = clouds.colors is not None
    return describe_by(clouds, [description_of(option, colored=colored) for option in per_cloud], max_bytes=max_bytes)


def describe_by(clouds: Clouds, descriptions: Sequence[Description], *, max_bytes: int = 1 << 28) -> DescribedClouds:
    """Describe every cloud as its description says; otherwise as ``describe_clouds``."""
    expect_alike(descriptions)
    for record in descriptions[0].descriptors if descriptions else ():
        expect(not record.is_pairwise, "options.descriptors", "descriptors of each cloud by itself", record)
    facts = facts_of(clouds)
    defects = [
        one.defect or too_wide(one, description.voxel_size)
        for one, description in zip(facts, descriptions, strict=True)
    ]
    usable = set_aside(hinted(clouds.detach()), defects)
    with undisturbed(clouds.points):
        thin = downsample(usable, [description.voxel_size for description in descriptions])
        described = describe_thin(thin, descriptions, max_bytes)
        return replace(described, facts=facts, surfels=surfels(usable, described.cloud, descriptions))


def hinted(clouds: Clouds) -> Clouds:
    """Clouds whose normals are hints at signs alone: zero where a scanner is known, whose position says more."""
    if clouds.normals is None:
        return clouds
    known = clouds.viewpoint_known.repeat_interleave(torch.tensor(clouds.lengths, device=clouds.device))
    return replace(clouds, normals=clouds.normals.masked_fill(known[:, None], 0.0))


def describe_thin(thin: Clouds, descriptions: Sequence[Description], max_bytes: int) -> DescribedClouds:
    """Describe clouds that are downsampled already; the rest as ``describe_by``.

    Where a descriptor is pairwise, clouds 2 i and 2 i + 1 are those of one pair.
    """
    slots = max(description.max_neighbors for description in descriptions)
    costs = [_SLOT_BYTES * slots * count for count in thin.lengths]
    groups = partition(costs, max_bytes)
    if any(description.is_pairwise for description in descriptions):
        groups = [slice(begin, begin + 2) for begin in range(0, len(thin), 2)]
    parts = []
    for group in groups:
        clouds, made = thin.select(range(len(thin))[group]), descriptions[group]
        reach = reach_of(made[0]) if len(made) == 1 and clouds.normals is None else None
        most = max_bytes // (_SLOT_BYTES * slots)
        if reach is not None and len(clouds.points) > max(most, _LEAST_TILE):
            parts.append(_described_in_tiles(clouds, made[0], reach, max(most, _LEAST_TILE)))
        else:
            parts.append(_described_at_once(clouds, made))
    return DescribedClouds.pack(parts)


def _described_at_once(clouds: Clouds, descriptions: Sequence[Description]) -> DescribedClouds:
    cloud, near = oriented(clouds, descriptions)
    features = describe(cloud, near, [description.descriptors for description in descriptions])
    spacings = tuple(map(_spacing, _fourth_distances(cloud, near).split(cloud.lengths)))
    keypoints = select(cloud, near, [description.keypoints for description in descriptions])
    return DescribedClouds(cloud, features, tuple(descriptions), spacings, facts_of(cloud), keypoints=keypoints)


def _described_in_tiles(cloud: Clouds, description: Description, reach: float, most: int) -> DescribedClouds:
    """One cloud, described in tiles for so many of its points; the same bits."""
    normals = torch.empty_like(cloud.points)
    fourth = cloud.points.new_empty(len(cloud.points))
    features: list[Features] = []
    rule = description.keypoints
    by_tiles = rule is not None and rule.support is not None
    keypoints = torch.zeros(len(normals), dtype=torch.bool, device=cloud.device) if by_tiles else None
    for rows, own in tiles_of(cloud, reach, most):
        part, near = oriented(cloud.rows(rows, offsets_of([len(rows)])), [description])
        described = describe(part, near, [description.descriptors])
        if not features:
            features = [_room_for(each, cloud) for each in described]
        mine = rows[own]
        estimated: Tensor = part.normals  # type: ignore[assignment]  # oriented gives them
        normals[mine], fourth[mine] = estimated[own], _fourth_distances(part, near)[own]
        for whole, each in zip(features, described, strict=True):
            whole.values[mine], whole.valid[mine] = each.values[own], each.valid[own]
        selected = select(part, near, [rule]) if keypoints is not None else None
        if keypoints is not None and selected is not None:
            keypoints[mine] = selected[own]
    whole_cloud, spacings = replace(cloud, normals=normals), (_spacing(fourth),)
    if not by_tiles:
        keypoints = select(whole_cloud, None, [rule])
    facts = facts_of(whole_cloud)
    return DescribedClouds(whole_cloud, tuple(features), (description,), spacings, facts, keypoints=keypoints)


def _room_for(features: Features, cloud: Clouds) -> Features:
    """Features of as many rows as the cloud has points, to be filled."""
    values = features.values.new_empty(len(cloud.points), features.values.shape[1])
    return Features(values, cloud.offsets, features.blocks, features.valid.new_zeros(len(values)))


def surfels(given: Clouds, thin: Clouds, descriptions: Sequence[Description]) -> Surfels | None:
    """The surfels of B clouds to refine poses on, of the clouds as given or of the thinned ones; ``None`` without.

    ``descriptions``, of every cloud, are alike in this.
    """
    if not descriptions or descriptions[0].refine == "none":
        return None
    return _made(given if descriptions[0].refine == "full" else thin, descriptions[0].refine_points)


@stage("surfels")
def _made(clouds: Clouds, count: int) -> Surfels:
    return surfels_of(clouds, count)


@stage("downsample")
def downsample(cloud: Clouds, voxel_sizes: Sequence[float | None]) -> Clouds:
    """Voxel means of the clouds that have a voxel size, in meters; all clouds in Z order."""
    if all(voxel_size is None for voxel_size in voxel_sizes):
        return in_morton_order(cloud)
    parts = [
        in_morton_order(single) if voxel_size is None else voxel_downsample(single, voxel_size)
        for single, voxel_size in zip(cloud.unpack(), voxel_sizes, strict=True)
    ]
    return Clouds.pack(parts)


@stage("neighbors and normals")
def oriented(cloud: Clouds, descriptions: Sequence[Description]) -> tuple[Clouds, Neighborhoods]:
    """Clouds with normals, and the neighborhoods that normals and descriptors share.

    Normals that the clouds have are hints at signs (``hinted``); lines are estimated anew.
    """
    radii = [description.widest for description in descriptions]
    widest = radii[0] if len(radii) == 1 else torch.tensor(radii, dtype=torch.float64)
    near = neighbors(cloud, widest, max(description.max_neighbors for description in descriptions))
    radii = [description.normal_radius for description in descriptions]
    support = _support(cloud, near, radii, descriptions[0].normal_max_neighbors)
    turned = estimate_normals(cloud, support)
    return turned if cloud.normals is None else orient_like(turned, cloud.normals, near), near


@stage("descriptors")
def describe(cloud: Clouds, near: Neighborhoods, descriptors: Sequence[Sequence[Descriptor]]) -> tuple[Features, ...]:
    """Features of every descriptor, not yet scaled or weighed, of B clouds with normals.

    ``near`` is as wide as every support at least; ``descriptors``, of every cloud, differ in lengths only.
    """
    return features_of(cloud, near, descriptors)


def features_of(
    cloud: Clouds, near: Neighborhoods, descriptors: Sequence[Sequence[Descriptor]]
) -> tuple[Features, ...]:
    """As ``describe``, as a part of another stage."""
    return tuple(_described(cloud, near, records) for records in zip(*descriptors, strict=True))


def support_of(cloud: Clouds, near: Neighborhoods, records: Sequence[Descriptor]) -> Neighborhoods:
    """The support of a descriptor, of which every cloud has a record."""
    return _support(cloud, near, [record.radius for record in records], records[0].max_neighbors)


def select(cloud: Clouds, near: Neighborhoods | None, rules: Sequence[Keypoints | None]) -> Tensor | None:
    """The points (P,) bool that are matched, by the rule of every cloud; ``None`` where there are no rules.

    ``near`` is as wide as every support at least; rules differ in lengths only.

    Raises:
        ValueError: rules for some of the clouds, or one that selects rows which the clouds do not have.
    """
    given = [rule for rule in rules if rule is not None]
    if not given:
        return None
    without = [number for number, rule in enumerate(rules) if rule is None]
    expect_in_words(not without, "keypoints", "a rule for every cloud or for none", f"none for the clouds {without}")
    return _selected(cloud, near, given)


@stage("keypoints")
def _selected(cloud: Clouds, near: Neighborhoods | None, given: Sequence[Keypoints]) -> Tensor:
    """The points (P,) bool that the rule of every cloud selects."""
    support, alike = None, all(rule == given[0] for rule in given)
    if given[0].support is not None and near is not None:
        reads = [rule.support for rule in given if rule.support is not None]
        support = _support(cloud, near, [each.radius for each in reads], reads[0].max_neighbors)
    if alike:
        return _marked(given[0], cloud, support)
    parts = [
        _marked(rule, single, None if support is None else support.of_rows(begin, end))
        for single, rule, (begin, end) in zip(cloud.unpack(), given, spans(cloud.offsets), strict=True)
    ]
    return torch.cat(parts)


def _marked(rule: Keypoints, cloud: Clouds, near: Neighborhoods | None) -> Tensor:
    """The points (P,) bool that one rule selects, checked."""
    name, count = f"{type(rule).__name__}.select", len(cloud.points)
    selected = rule.select(cloud, near)
    expect(isinstance(selected, KeypointRows), name, "KeypointRows", selected)
    expect_shape(selected.rows, f"{name}: rows", ("K",), torch.int64, cloud.device)
    legal = bool(((selected.rows >= 0) & (selected.rows < count)).all())
    expect(legal, f"{name}: rows", f"rows 0 to {count - 1} of the clouds", "others")
    return marked(selected.rows, count)


def expect_alike(options: Sequence[RegistrationOptions] | Sequence[Description]) -> None:
    """Raise ``ValueError`` where options of one batch differ in more than lengths."""
    for option in options[1:]:
        alike = besides_lengths(option) == besides_lengths(options[0])
        expect(alike, "options", "options that differ in lengths only within one batch", option)


def _described(cloud: Clouds, near: Neighborhoods, records: Sequence[Descriptor]) -> Features:
    """Features of one descriptor, of which every cloud has a record."""
    support, first = support_of(cloud, near, records), records[0]
    if first.is_batched or all(record == first for record in records):
        return _checked(first.describe(cloud, support), cloud, first)
    parts = [
        _checked(record.describe(single, support.of_rows(begin, end)), single, record)
        for single, record, (begin, end) in zip(cloud.unpack(), records, spans(cloud.offsets), strict=True)
    ]
    values, valid = torch.cat([part.values for part in parts]), torch.cat([part.valid for part in parts])
    return Features(values, cloud.offsets, parts[0].blocks, valid)


def _checked(features: Features, cloud: Clouds, record: Descriptor) -> Features:
    name = f"{type(record).__name__}.describe"
    expect(isinstance(features, Features), name, "Features", features)
    expect(
        torch.equal(features.offsets, cloud.offsets), name, f"a row for each of {len(cloud.points)} points", features
    )
    expect(features.values.dtype == cloud.points.dtype, name, f"values in {cloud.points.dtype}", features.values)
    size = largest_entries(features.values)
    broken = ~torch.isfinite(size) | (~features.valid & (size != 0))
    expect_in_words(
        not bool(broken.any()),
        name,
        "rows of finite numbers, zero where they are not valid",
        f"{int(broken.sum())} other rows",
    )
    return features


def _support(cloud: Clouds, near: Neighborhoods, radii: Sequence[float], max_neighbors: int) -> Neighborhoods:
    """The neighborhoods cut to one radius per cloud, meters."""
    if all(radius == radii[0] for radius in radii):
        return near.restrict(radii[0], max_neighbors)
    lengths = torch.tensor(cloud.lengths)
    per_point: Tensor = torch.tensor(radii, dtype=torch.float64).repeat_interleave(lengths).to(cloud.device)
    return near.restrict(per_point, max_neighbors)


def _fourth_distances(cloud: Clouds, near: Neighborhoods) -> Tensor:
    """(P,) squared meters to the fourth nearest other point; NaN for points that do not have as many."""
    slot = min(_SPACING_NEIGHBOR, near.index.shape[1] - 1)
    return near.sq_distance[:, slot].where(near.valid[:, slot], torch.nan)


def _spacing(fourth: Tensor) -> float:
    """The median distance, meters, of the squared ones (P,) that are known."""
    square = fourth[~fourth.isnan()]
    median = float(square.double().sqrt().median()) if len(square) > 0 else math.nan
    return median if median > 0 else 1e-9
