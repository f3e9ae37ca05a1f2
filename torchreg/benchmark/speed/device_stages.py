"""What is timed on a device: every stage on what the earlier ones made, and the whole pair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import torch

from torchreg.benchmark.speed.scene import TimedScene
from torchreg.benchmark.speed.subjects import Run
from torchreg.descriptors.contrast import contrast
from torchreg.descriptors.fpfh import fpfh
from torchreg.descriptors.pcfh import pcfh
from torchreg.matching import match_mutual
from torchreg.neighborhoods import neighbors
from torchreg.preprocess import estimate_normals, voxel_downsample
from torchreg.refinement import IcpOptions
from torchreg.refinement.icp import icp
from torchreg.refinement.surfels import surfels_of
from torchreg.registration import options_for
from torchreg.registration.register import register
from torchreg.solvers import CompatibilityOptions, RansacOptions
from torchreg.solvers.compatibility import compatibility
from torchreg.solvers.ransac import ransac

OURS = "torchreg"

NORMALS_WITHIN, NORMALS_FROM = 2, 30  # spacings and neighbors
SUPPORT = 5  # spacings, of descriptors


@dataclass(frozen=True, kw_only=True)
class DeviceStage:
    """One function that is timed."""

    build: Callable[[TimedScene], Run]  # makes what is run
    power: float = 1.0  # by which its cost is expected to grow with the points


def _downsample(scene: TimedScene) -> Run:
    side = scene.source
    return lambda: voxel_downsample(side.cloud, 3 * side.spacing)


def _search(scene: TimedScene) -> Run:
    side = scene.source
    return lambda: neighbors(side.cloud, SUPPORT * side.spacing, side.max_neighbors)


def _normals(scene: TimedScene) -> Run:
    side = scene.source
    near = side.near.restrict(NORMALS_WITHIN * side.spacing, NORMALS_FROM)
    return lambda: estimate_normals(side.cloud, near)


def _fpfh(scene: TimedScene) -> Run:
    side = scene.source
    return lambda: fpfh(side.oriented, side.near)


def _pcfh(scene: TimedScene) -> Run:
    side = scene.source
    near = side.near.restrict(NORMALS_WITHIN * side.spacing)
    return lambda: pcfh(side.oriented, near)


def _contrast(scene: TimedScene) -> Run:
    side = scene.source
    return lambda: contrast(side.oriented, side.near, SUPPORT * side.spacing)


def _surfels(scene: TimedScene) -> Run:
    return lambda: surfels_of(scene.source.cloud, 20_000)


def _match(scene: TimedScene) -> Run:
    return lambda: match_mutual(scene.source.features, scene.target.features)


def _ransac(scene: TimedScene) -> Run:
    options = RansacOptions(confidence=1.0, inlier_threshold=1.5 * scene.source.spacing)
    return lambda: ransac(scene.source.cloud, scene.target.cloud, scene.matches, options)


def _compatibility(scene: TimedScene) -> Run:
    options = CompatibilityOptions(inlier_threshold=1.5 * scene.source.spacing)
    return lambda: compatibility(scene.source.cloud, scene.target.cloud, scene.matches, options)


def _icp(scene: TimedScene) -> Run:
    source, target = scene.source.oriented, scene.target.oriented
    start = torch.eye(4, dtype=torch.float64, device=source.device)
    options = IcpOptions(kind="point_to_plane", max_distance=10 * scene.source.spacing, iterations=10)
    return lambda: icp(source, target, start, options)


def _whole(effort: str, scene: TimedScene) -> Run:
    options = replace(options_for(scene.source.spacing, effort=effort), voxel_size=None)
    return lambda: register(scene.source.cloud, scene.target.cloud, options)


STAGES: dict[str, DeviceStage] = {
    "downsample": DeviceStage(build=_downsample),
    "neighbor search": DeviceStage(build=_search),
    "normals": DeviceStage(build=_normals),
    "FPFH": DeviceStage(build=_fpfh),
    "PCFH": DeviceStage(build=_pcfh),
    "contrast": DeviceStage(build=_contrast),
    "surfels": DeviceStage(build=_surfels),
    "mutual matching": DeviceStage(build=_match, power=1.5),
    "RANSAC, 600,000 hypotheses": DeviceStage(build=_ransac),
    "compatibility": DeviceStage(build=_compatibility),
    "ICP, point to plane, 10 iterations": DeviceStage(build=_icp, power=1.5),
    **{
        f"whole pair, {effort}": DeviceStage(build=partial(_whole, effort), power=1.3)
        for effort in ("plain", "fast", "balanced")
    },
}
