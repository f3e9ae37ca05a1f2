"""What a pair lacks before anything is computed, and what its user should know."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from torchreg.types import Clouds, RegistrationOptions
from torchreg.types.packing import offsets_of, spans

_LEAST_POINTS = 4
_FARTHEST = 1e15  # meters: squares stay finite in float32
_MOST_VOXELS = 1e6  # a side: what voxels can be numbered by


def refuse(source: Clouds, target: Clouds) -> list[str]:
    """Why each pair cannot be registered at all, or an empty text."""
    return [
        _defect(one, "source") or _defect(other, "target")
        for one, other in zip(source.unpack(), target.unpack(), strict=True)
    ]


def too_wide(source: Clouds, target: Clouds, options: Sequence[RegistrationOptions]) -> list[str]:
    """Why the voxels of each pair cannot be numbered, or an empty text."""
    found = []
    for one, other, option in zip(source.unpack(), target.unpack(), options, strict=True):
        reason = ""
        for name, cloud in (("source", one), ("target", other)):
            if option.voxel_size is None or len(cloud.points) == 0:
                continue
            extent = float((cloud.points.amax(dim=0) - cloud.points.amin(dim=0)).amax())
            if extent > _MOST_VOXELS * option.voxel_size:
                reason = f"points too far apart: {extent:.3g} m in the {name}, for voxels of {option.voxel_size:.3g} m"
        found.append(reason)
    return found


def set_aside(clouds: Clouds, refused: Sequence[str]) -> Clouds:
    """The same batch with the clouds of refused pairs emptied, so that they do not touch the others."""
    if not any(refused):
        return clouds
    kept = [
        torch.arange(begin, end) if not reason else torch.zeros(0, dtype=torch.int64)
        for (begin, end), reason in zip(spans(clouds.offsets), refused, strict=True)
    ]
    return clouds.rows(torch.cat(kept).to(clouds.device), offsets_of(map(len, kept)))


def notes_on(source: Clouds, target: Clouds, options: Sequence[RegistrationOptions]) -> tuple[tuple[str, ...], ...]:
    """Remarks on every pair: missing colors or viewpoints, and what is done without them."""
    notes = []
    for b, option in enumerate(options):
        said = []
        bare = [name for name, cloud in (("source", source), ("target", target)) if cloud.colors is None]
        if bare:
            said.append(f"no colors in {' and '.join(bare)}: FPFH alone")
        for name, cloud in (("source", source), ("target", target)):
            if cloud.viewpoint is None or not bool(torch.isfinite(cloud.viewpoint[b]).all()):
                said.append(f"no viewpoint for the {name}: its normals are turned to its mean point")
        for name, cloud in (("source", source), ("target", target)):
            if cloud.colors is not None:
                colors = cloud.select(b).colors
                if colors is not None and len(colors) > 0 and bool((colors < 0).any() | (colors > 1).any()):
                    low, high = float(colors.amin()), float(colors.amax())
                    said.append(f"colors of the {name} from {low:.3g} to {high:.3g}: expected 0 to 1")
        if option.voxel_size is not None:
            said.append(f"downsampled to voxels of {option.voxel_size:.3g} m")
        notes.append(tuple(said))
    return tuple(notes)


def _defect(cloud: Clouds, name: str) -> str:
    points = cloud.points
    if len(points) < _LEAST_POINTS:
        return f"too few points: the {name} has {len(points)}, at least {_LEAST_POINTS} are needed"
    if not bool(torch.isfinite(cloud.origin).all()):
        return f"an origin that is not finite in the {name}"
    finite = torch.isfinite(points).all(dim=1)
    if not bool(finite.all()):
        return f"points that are not finite: {int((~finite).sum())} of {len(points)} in the {name}"
    if float(points.abs().amax()) > _FARTHEST:
        return f"points too far out: up to {float(points.abs().amax()):.3g} m in the {name}, at most {_FARTHEST:.0e} m"
    if cloud.colors is not None and not bool(torch.isfinite(cloud.colors).all()):
        return f"colors that are not finite in the {name}"
    centered = (points - points[:1]).double()
    if not bool((centered != 0).any()):
        return f"a degenerate cloud: all {len(points)} points of the {name} coincide"
    centered = centered - centered.mean(dim=0)
    spread = torch.linalg.eigvalsh(centered.t() @ centered)
    if float(spread[1]) <= 1e-12 * float(spread[2]):
        return f"a degenerate cloud: the points of the {name} lie on one line"
    return ""
