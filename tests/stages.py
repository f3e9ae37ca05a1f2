"""Every stage from clouds to poses, each with how near a GPU comes to the CPU and how often it waits for the host."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from closeness import close
from problems import correspondence_problem, room_pair
from torch import Tensor

import torchreg as tr
from torchreg.learning.network_training import drawn_network
from torchreg.neighborhoods.point_index import nearest
from torchreg.nn import FPFH, PCFH, Register
from torchreg.preprocess.orientation import orient_along_surfaces
from torchreg.refinement.options import KINDS
from torchreg.refinement.surfels import surfels_of
from torchreg.registration.describe import describe_clouds

RADIUS = 1.0
THRESHOLD = 0.05


@dataclass(frozen=True, eq=False)
class Given:
    """What stages take, all of it made on the CPU: a pair of clouds and the result of every stage before."""

    source: tr.Clouds
    target: tr.Clouds
    near: tr.Neighborhoods
    oriented: tr.Clouds
    other: tr.Clouds  # the target with normals
    features: tr.Features
    other_features: tr.Features
    matches: tr.Correspondences
    truth: Tensor  # (1, 4, 4)
    problem: tuple[tr.Clouds, tr.Clouds, tr.Correspondences]  # matches with known truth, many of them wrong
    batch: tuple[tr.Clouds, tr.Clouds]  # three pairs


def given(count: int) -> Given:
    """Everything for a room of ``count`` points a scan."""
    pair = room_pair(count)
    sides = []
    for cloud in (pair.source, pair.target):
        near = tr.neighbors(cloud, RADIUS, 60)
        oriented = tr.estimate_normals(cloud, near.restrict(0.5, 30))
        sides.append((near, oriented, tr.fuse(tr.fpfh(oriented, near), tr.contrast(oriented, near, RADIUS))))
    problem = correspondence_problem()
    batch = [room_pair(count // 4, seed=seed) for seed in (1, 2, 3)]
    return Given(
        source=pair.source,
        target=pair.target,
        near=sides[0][0],
        oriented=sides[0][1],
        other=sides[1][1],
        features=sides[0][2],
        other_features=sides[1][2],
        matches=tr.match_mutual(sides[0][2], sides[1][2]),
        truth=pair.T_target_source,
        problem=(problem.source, problem.target, problem.matches),
        batch=(tr.Clouds.pack([one.source for one in batch]), tr.Clouds.pack([one.target for one in batch])),
    )


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One function on the way.

    Attributes:
        run: from what is given, on some device, to tensors there, records of them, or numbers.
        transfers: times it may make a GPU wait for the host, for a pair (three in a batch), whatever the number of
            points.
        atol: by how much numbers may differ from the CPU's; 0 where each is decided by itself, in a fixed order.
        share: of the rows of a tensor that may differ by more: votes at the edge of a bin.
        on_gpu: by how much numbers may differ on a real GPU, where arctangents, exponentials and sums round otherwise,
            so that single votes and matches change; 0 where this changes nothing.
        whole: takes seconds.
    """

    run: Callable[[Given], Any]
    transfers: int
    atol: float = 0.0
    share: float = 0.0
    on_gpu: float = 0.0
    whole: bool = False

    def on(self, device: str) -> Stage:
        """The same with what it promises on a device."""
        return replace(self, atol=max(self.atol, self.on_gpu)) if torch.device(device).type == "cuda" else self


def _whole(run: Callable[[Given], Any], transfers: int) -> Stage:
    return Stage(run=run, transfers=transfers, atol=1e-6, on_gpu=0.05, whole=True)


def _icp(kind: str, g: Given) -> Any:
    start = g.truth.clone()
    start[:, :3, 3] += 0.03
    result = tr.icp(g.oriented, g.other, start, tr.IcpOptions(kind=kind, max_distance=0.3))
    return result.T_target_source, result.fitness, result.converged


def _pose(result: tr.RegistrationResult) -> Any:
    return result.success, result.T_target_source, result.probability


def _thinned() -> tr.RegistrationOptions:
    return tr.options_for(0.2, voxel_size=0.2)


def _on_keypoints() -> tr.RegistrationOptions:
    return replace(tr.options_for(0.1), keypoints=tr.IssKeypoints.for_spacing(0.2))


def _verdict(verification: tr.Verification) -> Any:
    return verification.success, verification.probability


def _soft_descriptors(g: Given) -> Any:
    points, colors = (value.clone().requires_grad_() for value in (g.source.points, g.source.colors))
    cloud = tr.estimate_normals(replace(g.source, points=points, colors=colors), g.near)
    geometry, color = tr.fpfh(cloud, g.near, binning="soft"), tr.pcfh(cloud, g.near, binning="soft")
    loss = geometry.values.square().sum() + color.values.square().sum()
    gradients = torch.autograd.grad(loss, (points, colors))  # 1e5 and more: beside the largest of them
    return geometry.values.detach(), color.values.detach(), *(each / each.abs().max() for each in gradients)


def _soft_match(method: str, g: Given) -> Any:
    rows = range(300)
    pieces = [f.values[: len(rows)].clone().requires_grad_() for f in (g.features, g.other_features)]
    offsets = torch.tensor([0, len(rows)])
    source, target = (
        tr.Features(piece, offsets, f.blocks, f.valid[: len(rows)])
        for piece, f in zip(pieces, (g.features, g.other_features), strict=True)
    )
    (confidence,) = tr.soft_match(source, target, method=method, temperature=0.1, dustbin=0.5).confidence
    return confidence.detach(), *torch.autograd.grad(confidence.square().sum(), pieces)


def _module(g: Given) -> Any:
    torch.manual_seed(0)
    module = Register(descriptors=[FPFH(), PCFH()]).to(g.source.device)
    return module(*g.batch).T_target_source.detach()


STAGES: dict[str, Stage] = {
    "voxel_downsample": Stage(run=lambda g: tr.voxel_downsample(g.source, 0.2), transfers=4),
    "random_downsample": Stage(run=lambda g: tr.random_downsample(g.source, 300), transfers=0),
    "farthest_point_downsample": Stage(run=lambda g: tr.farthest_point_downsample(g.source, 30), transfers=1),
    "iss_keypoints": Stage(run=lambda g: tr.iss_keypoints(g.source, g.near, 0.5), transfers=8, on_gpu=1e-9),
    "uniform_keypoints": Stage(run=lambda g: tr.uniform_keypoints(g.source, 0.4), transfers=8),
    "farthest_keypoints": Stage(run=lambda g: tr.farthest_keypoints(g.source, 30), transfers=2),
    "spacing": Stage(run=lambda g: tr.spacing(g.source), transfers=20, atol=1e-9),
    "neighbors": Stage(run=lambda g: tr.neighbors(g.source, RADIUS, 60), transfers=10),
    "nearest": Stage(run=lambda g: nearest(g.source.points, g.target.points), transfers=2),
    "estimate_normals": Stage(run=lambda g: tr.estimate_normals(g.source, g.near), transfers=0, atol=1e-4),
    "orient_along_surfaces": Stage(run=lambda g: orient_along_surfaces(g.oriented, g.near), transfers=12),
    "fpfh": Stage(run=lambda g: tr.fpfh(g.oriented, g.near), transfers=2, atol=1e-2, share=0.02),
    "fpfh, pcl": Stage(run=lambda g: tr.fpfh(g.oriented, g.near, mode="pcl"), transfers=2, atol=1e-2, share=0.02),
    "pcfh": Stage(run=lambda g: tr.pcfh(g.oriented, g.near), transfers=2, atol=1e-2, share=0.02),
    "contrast": Stage(run=lambda g: tr.contrast(g.oriented, g.near, RADIUS), transfers=1, atol=1e-5),
    "local_frames": Stage(run=lambda g: tr.local_frames(g.oriented, g.near), transfers=1, atol=1e-4, share=0.02),
    "shot": Stage(run=lambda g: tr.shot(g.oriented, g.near), transfers=3, atol=1e-4, share=0.02),
    "cshot": Stage(run=lambda g: tr.cshot(g.oriented, g.near), transfers=5, atol=1e-4, share=0.02),
    "unique_shape_context": Stage(
        run=lambda g: tr.unique_shape_context(g.oriented, g.near), transfers=4, atol=1e-2, share=0.02
    ),
    "pfh": Stage(run=lambda g: tr.pfh(g.oriented, g.near), transfers=3, atol=1e-2, share=0.02),
    "pfhrgb": Stage(run=lambda g: tr.pfhrgb(g.oriented, g.near), transfers=4, atol=1e-2, share=0.02),
    "spin_images": Stage(run=lambda g: tr.spin_images(g.oriented, g.near), transfers=2, atol=1e-5),
    "shape_context": Stage(run=lambda g: tr.shape_context(g.oriented, g.near), transfers=4, atol=1e-2, share=0.02),
    "learned": Stage(
        run=lambda g: tr.Learned(radius=RADIUS, max_neighbors=60).describe(g.oriented, g.near), transfers=8, atol=1e-4
    ),
    "fuse": Stage(run=lambda g: tr.fuse(g.features, g.features), transfers=0, atol=1e-6),
    "match_mutual": Stage(run=lambda g: tr.match_mutual(g.features, g.other_features), transfers=12),
    "match_mutual, ratio": Stage(run=lambda g: tr.match_mutual(g.features, g.other_features, ratio=0.95), transfers=12),
    "ransac": Stage(
        run=lambda g: tr.ransac(*g.problem, tr.RansacOptions(inlier_threshold=THRESHOLD)).T_target_source,
        transfers=70,
        atol=1e-9,
    ),
    "compatibility": Stage(
        run=lambda g: tr.compatibility(*g.problem, tr.CompatibilityOptions(inlier_threshold=THRESHOLD)).T_target_source,
        transfers=260,
        atol=1e-9,
    ),
    **{f"icp, {kind}": Stage(run=partial(_icp, kind), transfers=12 * 30, atol=1e-9, on_gpu=1e-6) for kind in KINDS},
    "surfels": Stage(run=lambda g: surfels_of(g.source, 400), transfers=20, atol=1e-4),
    "describe": Stage(
        run=lambda g: describe_clouds(g.source, tr.options_for(0.1)).features, transfers=60, atol=1e-2, share=0.02
    ),
    "verify": _whole(lambda g: _verdict(tr.verify(g.source, g.target, g.truth)), 1300),
    "register, plain": _whole(lambda g: _pose(tr.register(g.source, g.target, effort="plain")), 300),
    "register, fast": _whole(lambda g: _pose(tr.register(g.source, g.target, effort="fast")), 600),
    "register, balanced": _whole(lambda g: _pose(tr.register(g.source, g.target)), 1000),
    "register, thorough": _whole(lambda g: _pose(tr.register(g.source, g.target, effort="thorough")), 5000),
    "register, on keypoints": _whole(lambda g: _pose(tr.register(g.source, g.target, _on_keypoints())), 1200),
    "register, refined coarsely": _whole(lambda g: _pose(tr.register(g.source, g.target, refine="coarse")), 1100),
    "register, the paper's preset": _whole(lambda g: _pose(tr.register(g.source, g.target, tr.PAPER)), 350),
    "register, a batch": _whole(lambda g: _pose(tr.register(*g.batch)), 2200),
    "register_features": _whole(
        lambda g: _pose(tr.register_features(g.source, g.target, g.features, g.other_features)), 1400
    ),
    "register_features, thinned": _whole(
        lambda g: _pose(tr.register_features(g.source, g.target, g.features, g.other_features, _thinned())), 1400
    ),
    "register_matches": _whole(lambda g: _pose(tr.register_matches(g.source, g.target, g.matches)), 1400),
    "register, described by a module": _whole(
        lambda g: _pose(tr.register(g.source, g.target, describe=FPFH(binning="hard"))), 1400
    ),
    "soft descriptors and their gradients": Stage(run=_soft_descriptors, transfers=8, atol=1e-3),
    "dual softmax and its gradient": Stage(run=partial(_soft_match, "dual_softmax"), transfers=0, atol=1e-5),
    "sinkhorn and its gradient": Stage(run=partial(_soft_match, "sinkhorn"), transfers=0, atol=1e-5),
    "nn.PointNetwork": Stage(
        run=lambda g: drawn_network(0).to(g.near.index.device)(g.oriented, g.near), transfers=4, atol=1e-4, share=0.02
    ),
    "nn.Register": Stage(run=_module, transfers=150, atol=1e-3),
}


def moved(value: Any, device: str) -> Any:
    """The same tensors, records and tuples on another device; offsets stay on the CPU, as everywhere."""
    if isinstance(value, Tensor):
        return value.to(device)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [field.name for field in dataclasses.fields(value) if field.init and "offsets" not in field.name]
        return replace(value, **{name: moved(getattr(value, name), device) for name in fields})
    if isinstance(value, tuple):
        parts = [moved(part, device) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def differences(result: Any, expected: Any, stage: Stage, path: str = "") -> list[str]:
    """What of a result, on any device, is not what the stage promises beside the CPU's."""
    if isinstance(expected, Tensor):
        return _of_tensors(result.detach().cpu(), expected.detach(), stage, path)
    if dataclasses.is_dataclass(expected):
        names = [field.name for field in dataclasses.fields(expected)]
        return [
            line
            for name in names
            for line in differences(getattr(result, name), getattr(expected, name), stage, f"{path}.{name}")
        ]
    if isinstance(expected, tuple) and not all(isinstance(part, str | int | float) for part in expected):
        pairs = enumerate(zip(result, expected, strict=True))
        return [line for number, both in pairs for line in differences(*both, stage, f"{path}[{number}]")]
    if isinstance(expected, float) or (isinstance(expected, tuple) and all(isinstance(x, float) for x in expected)):
        return differences(torch.tensor(result).double(), torch.tensor(expected).double(), stage, path)
    return [] if result == expected else [f"{path}: {result!r}, on the CPU {expected!r}"]


def _of_tensors(result: Tensor, expected: Tensor, stage: Stage, path: str) -> list[str]:
    if result.shape != expected.shape or result.dtype != expected.dtype:
        return [f"{path}: {tuple(result.shape)} {result.dtype}, on the CPU {tuple(expected.shape)} {expected.dtype}"]
    left, right = (values.double().nan_to_num(7e7) for values in (result, expected))
    if close(left, right, stage.atol if expected.is_floating_point() else 0.0):
        return []
    gap = (left - right).abs()
    rows = (gap.reshape(len(gap), -1) > stage.atol).any(dim=1).double().mean() if gap.dim() > 0 else torch.ones(())
    return [] if rows <= stage.share else [f"{path}: off by {float(gap.max()):.2e}, {float(rows):.2%} of the rows"]
