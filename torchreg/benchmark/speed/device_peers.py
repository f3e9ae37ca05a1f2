"""Peers on a GPU, where they are installed: Open3D's tensors and cuVS."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchreg.benchmark.speed.device_stages import NORMALS_FROM, NORMALS_WITHIN, SUPPORT
from torchreg.benchmark.speed.scene import TimedCloud, TimedScene
from torchreg.benchmark.speed.subjects import Run
from torchreg.open3d_loader import load_open3d


@dataclass(frozen=True, kw_only=True)
class DevicePeer:
    """Another library on the same device."""

    name: str
    gap: Callable[[torch.device], str]  # why it cannot run there, or an empty text
    stages: Mapping[str, Callable[[TimedScene], Run]]  # by the names of ours


def _open3d_gap(device: torch.device) -> str:
    if device.type == "cpu" or load_open3d().core.cuda.is_available():
        return ""
    return "this Open3D is built without CUDA"


def _core_tensor(tensor: Tensor) -> Any:  # noqa: ANN401
    return load_open3d().core.Tensor.from_dlpack(tensor.contiguous().__dlpack__())


def _cloud(side: TimedCloud, *, oriented: bool) -> Any:  # noqa: ANN401
    positions = _core_tensor(side.cloud.points)
    cloud = load_open3d().t.geometry.PointCloud(positions.device)
    cloud.point.positions = positions
    if oriented and side.oriented.normals is not None:
        cloud.point.normals = _core_tensor(side.oriented.normals)
    return cloud


def _open3d_downsample(scene: TimedScene) -> Run:
    cloud = _cloud(scene.source, oriented=False)
    return lambda: cloud.voxel_down_sample(3 * scene.source.spacing)


def _open3d_search(scene: TimedScene) -> Run:
    core, side = load_open3d().core, scene.source
    points, radius = _core_tensor(side.cloud.points), SUPPORT * side.spacing

    def run() -> object:
        index = core.nns.NearestNeighborSearch(points, core.int32)
        index.hybrid_index(radius)
        return index.hybrid_search(points, radius, side.max_neighbors)

    return run


def _open3d_normals(scene: TimedScene) -> Run:
    cloud = _cloud(scene.source, oriented=False)
    return lambda: cloud.estimate_normals(NORMALS_FROM, NORMALS_WITHIN * scene.source.spacing)


def _open3d_fpfh(scene: TimedScene) -> Run:
    side = scene.source
    cloud, describe = _cloud(side, oriented=True), load_open3d().t.pipelines.registration.compute_fpfh_feature
    return lambda: describe(cloud, side.max_neighbors, SUPPORT * side.spacing)


def _open3d_icp(scene: TimedScene) -> Run:
    registration = load_open3d().t.pipelines.registration
    source, target = _cloud(scene.source, oriented=True), _cloud(scene.target, oriented=True)
    criteria = registration.ICPConvergenceCriteria(0.0, 0.0, 10)
    return lambda: registration.icp(
        source,
        target,
        10 * scene.source.spacing,
        estimation_method=registration.TransformationEstimationPointToPlane(),
        criteria=criteria,
    )


def _cuvs_gap(device: torch.device) -> str:
    if device.type != "cuda":
        return "cuVS runs on GPUs alone"
    try:
        importlib.import_module("cuvs.neighbors.brute_force")
    except ImportError as problem:
        return f"cuVS cannot be imported ({problem})"
    return ""


def _cuvs_matches(scene: TimedScene) -> Run:
    """The nearest feature both ways, exactly; which of them are mutual."""
    brute_force = importlib.import_module("cuvs.neighbors.brute_force")
    source, target = (side.features.values.contiguous() for side in (scene.source, scene.target))

    def nearest(query: Tensor, table: Tensor) -> Tensor:
        index = brute_force.build(table, metric="sqeuclidean")
        _, rows = brute_force.search(index, query, 1)
        return torch.as_tensor(rows, device=query.device)[:, 0].long()

    def run() -> Tensor:
        forth, back = nearest(source, target), nearest(target, source)
        return (back[forth] == torch.arange(len(source), device=source.device)).nonzero()

    return run


PEERS = (
    DevicePeer(
        name="Open3D, tensor",
        gap=_open3d_gap,
        stages={
            "downsample": _open3d_downsample,
            "neighbor search": _open3d_search,
            "normals": _open3d_normals,
            "FPFH": _open3d_fpfh,
            "ICP, point to plane, 10 iterations": _open3d_icp,
        },
    ),
    DevicePeer(name="cuVS", gap=_cuvs_gap, stages={"mutual matching": _cuvs_matches}),
)
