"""Clouds as given: why a pair cannot be registered, and what its user should know."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch

from torchreg.descriptors.descriptor import Descriptor
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.units import Lengths, extents_note, feet_note, rough_spacing, units_failure
from torchreg.types import Clouds, Failure
from torchreg.types.loading import loadable
from torchreg.types.packing import kept_rows

_LEAST_POINTS = 4
_FEW_POINTS = 100
_MANY_POINTS = 200_000
_FARTHEST = 1e15  # meters: squares stay finite in float32
_MOST_VOXELS = 1e6  # a side: what voxels can be numbered by


@loadable
class CloudFacts(NamedTuple):
    """The facts of one cloud as it was given."""

    points: int  # how many
    extent: float  # meters, the longest edge of its bounding box; 0 where that means nothing
    spacing: float  # meters, of its points, to some 15 %; 0 where that means nothing
    # why it cannot be registered, ``{}`` in its text standing for its role in a pair; ``None`` where it can
    defect: Failure | None
    colors: tuple[float, float] | None  # the least and the greatest number among its colors; ``None`` without colors
    faced: bool  # whether its viewpoint is known
    assumed: bool  # whether it has a viewpoint that is only a guess
    normals: bool  # whether it has normals

    @property
    def lengths(self) -> Lengths:
        """Extent and spacing."""
        return Lengths(self.extent, self.spacing)


def facts_of(clouds: Clouds) -> tuple[CloudFacts, ...]:
    """The facts of every cloud of a batch."""
    return tuple(map(_facts, clouds.unpack()))


def refuse(source: Clouds, target: Clouds) -> list[Failure | None]:
    """Why each pair cannot be registered at all; ``None`` where it can."""
    return [refusal(one, other) for one, other in zip(facts_of(source), facts_of(target), strict=True)]


def refusal(source: CloudFacts, target: CloudFacts, options: RegistrationOptions | None = None) -> Failure | None:
    """Why one pair cannot be registered, with these options if they are known already; ``None`` where it can."""
    for name, facts in (("source", source), ("target", target)):
        if facts.defect is not None:
            return _in_role(facts.defect, name)
    units = units_failure(source.lengths, target.lengths)
    if units is not None:
        return units
    if options is not None:
        for name, facts in (("target", target), ("source", source)):
            failure = too_wide(facts, options.voxel_size)
            if failure is not None:
                return _in_role(failure, name)
    return None


def too_wide(facts: CloudFacts, voxel_size: float | None) -> Failure | None:
    """Why the voxels of a cloud cannot be numbered, ``{}`` standing for its role; ``None`` where they can."""
    if voxel_size is None or facts.extent <= _MOST_VOXELS * voxel_size:
        return None
    text = f"points too far apart: {facts.extent:.3g} m in the {{}}, for voxels of {voxel_size:.3g} m"
    return Failure("too wide", text, {"extent": facts.extent, "voxel_size": voxel_size})


def _in_role(failure: Failure, name: str) -> Failure:
    return replace(failure, text=failure.text.format(name))


def set_aside(clouds: Clouds, refused: Sequence[object]) -> Clouds:
    """The same batch, the clouds of refused pairs without points, so that they do not affect the others."""
    if not any(refused):
        return clouds
    index, offsets = kept_rows(clouds.offsets, refused)
    return clouds.rows(index.to(clouds.device), offsets)


def notes_on(source: Clouds, target: Clouds, options: Sequence[RegistrationOptions]) -> tuple[tuple[str, ...], ...]:
    """Remarks on every pair, such as missing colors or viewpoints and their consequence."""
    return tuple(map(pair_notes, facts_of(source), facts_of(target), options))


def pair_notes(source: CloudFacts, target: CloudFacts, options: RegistrationOptions) -> tuple[str, ...]:
    """Remarks on one pair."""
    notes = []
    sides = (("source", source), ("target", target))
    bare = [name for name, facts in sides if facts.colors is None]
    if bare:
        notes.append(f"no colors in {' and '.join(bare)}: geometry alone is matched")
    for name, facts in sides:
        if not facts.faced and not facts.assumed:
            notes.append(f"no viewpoint for the {name}: its normals are turned to its mean point")
    guessed = [name for name, facts in sides if facts.assumed]
    if guessed:
        consequence = "normals are turned to it to propose poses, but neither their signs nor free space are evidence"
        notes.append(f"the scanner's position is only assumed for the {' and the '.join(guessed)}: {consequence}")
    for name, facts in sides:
        if facts.normals:
            use = "turned to its scanner" if facts.faced else "on the sides of the given ones, where these agree"
            notes.append(f"normals of the {name} are estimated anew, {use}")
    for name, facts in sides:
        if facts.colors is not None and (facts.colors[0] < 0 or facts.colors[1] > 1):
            low, high = facts.colors
            notes.append(f"colors of the {name} from {low:.3g} to {high:.3g}: expected 0 to 1")
    lengths = source.lengths, target.lengths
    notes += [note for note in (extents_note(*lengths), feet_note(*lengths)) if note]
    if options.voxel_size is not None:
        notes.append(f"downsampled to voxels of {options.voxel_size:.3g} m")
    return tuple(notes)


def few_points_notes(points: tuple[int, int], options: RegistrationOptions) -> tuple[str, ...]:
    """Remarks where so few points of a source and a target are left that hardly a pose follows from them."""
    why = "" if options.voxel_size is None else f" after downsampling to voxels of {options.voxel_size:.3g} m"
    sides = zip(("source", "target"), points, strict=True)
    return tuple(f"only {count} points of the {name} are left{why}" for name, count in sides if 0 < count < _FEW_POINTS)


def keypoints_failure(failure: Failure | None, counts: tuple[int, int], options: RegistrationOptions) -> Failure | None:
    """The failure of a pair, which says so where keypoints, of the source and the target, are too few to be matched."""
    rule, least = options.keypoints, options.solver.least_matches
    if rule is None or failure is None or failure.kind != "too few matches" or min(counts) >= least:
        return failure
    text = f"{failure.text}: {counts[0]} keypoints ({rule.name}) in the source, {counts[1]} in the target"
    figures = {**failure.figures, "keypoints_source": counts[0], "keypoints_target": counts[1]}
    return replace(failure, text=text, figures=figures)


def keypoints_notes(counts: tuple[int, int], points: tuple[int, int], options: RegistrationOptions) -> tuple[str, ...]:
    """Remarks where keypoints alone are matched."""
    if options.keypoints is None:
        return ()
    each = zip(counts, points, ("source", "target"), strict=True)
    shares = " and ".join(f"{count:,} of {total:,} points of the {side}" for count, total, side in each)
    return (f"keypoints ({options.keypoints.name}) alone are matched: {shares}",)


def undescribed_failure(failure: Failure | None, undescribed: Sequence[str]) -> Failure | None:
    """The failure of a pair, which names the descriptors that leave too little to be matched (``undescribed_note``)."""
    if failure is None or failure.kind != "too few matches" or not undescribed:
        return failure
    return replace(failure, text="; ".join((failure.text, *undescribed)))


def undescribed_note(record: Descriptor, name: str, spacing: float) -> str:
    """A remark on a descriptor whose rows are all invalid on one side, with what decides that most often: its scale."""
    lengths = f"its radius is {record.radius:.3g} m, the spacing of the points {spacing:.3g} m"
    return f"{record.name} describes no point of the {name}: {lengths}"


def warn_of_many_points(points: int, options: RegistrationOptions) -> None:
    """Warn, once in a process, where options such as ``PAPER`` describe and match hundreds of thousands of points."""
    if options.voxel_size is None and points >= _MANY_POINTS:
        warnings.warn(
            "options without a voxel_size, such as PAPER and LEARNED, describe and match all points; with hundreds of "
            "thousands of them this takes minutes to hours: set voxel_size, or thin the clouds before by "
            "voxel_downsample or random_downsample",
            UserWarning,
            stacklevel=2,
        )


def _facts(cloud: Clouds) -> CloudFacts:
    """The facts of a batch of one."""
    colors, extent = None, 0.0
    if cloud.colors is not None:
        empty = cloud.colors.numel() == 0
        colors = (0.0, 0.0) if empty else (float(cloud.colors.amin()), float(cloud.colors.amax()))
    if len(cloud.points) > 0:
        extent = float((cloud.points.amax(dim=0) - cloud.points.amin(dim=0)).amax())
    defect = _defect(cloud)
    return CloudFacts(
        points=len(cloud.points),
        extent=extent,
        spacing=0.0 if defect else rough_spacing(cloud),
        defect=defect,
        colors=colors,
        faced=bool(cloud.viewpoint_known.all()),
        assumed=bool(cloud.viewpoint_assumed.any()),
        normals=cloud.normals is not None,
    )


def _defect(cloud: Clouds) -> Failure | None:
    points = cloud.points
    if len(points) < _LEAST_POINTS:
        text = f"too few points: the {{}} has {len(points)}, at least {_LEAST_POINTS} are needed"
        return Failure("too few points", text, {"points": len(points), "needed": _LEAST_POINTS})
    if not bool(torch.isfinite(cloud.origin).all()):
        return Failure("not finite", "an origin that is not finite in the {}")
    finite = torch.isfinite(points).all(dim=1)
    if not bool(finite.all()):
        count = int((~finite).sum())
        text = f"points that are not finite: {count} of {len(points)} in the {{}}"
        return Failure("not finite", text, {"points": count})
    farthest = float(points.abs().amax())
    if farthest > _FARTHEST:
        text = f"points too far out: up to {farthest:.3g} m in the {{}}, at most {_FARTHEST:.0e} m"
        return Failure("too wide", text, {"extent": farthest})
    if cloud.colors is not None and not bool(torch.isfinite(cloud.colors).all()):
        return Failure("not finite", "colors that are not finite in the {}")
    centered = (points - points[:1]).double()
    if not bool((centered != 0).any()):
        return Failure("degenerate", f"a degenerate cloud: all {len(points)} points of the {{}} coincide")
    centered = centered - centered.mean(dim=0)
    spread = torch.linalg.eigvalsh(centered.t() @ centered)
    if float(spread[1]) <= 1e-12 * float(spread[2]):
        return Failure("degenerate", "a degenerate cloud: the points of the {} lie on one line")
    return None
