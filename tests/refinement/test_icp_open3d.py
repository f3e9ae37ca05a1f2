"""The same transforms as Open3D from the same start, iterate by iterate."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from closeness import close

import torchreg as tr
from torchreg.open3d_loader import load_open3d
from torchreg.refinement import IcpOptions
from torchreg.refinement.generalized import EPSILON
from torchreg.refinement.icp import icp

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
KINDS = ("point_to_point", "point_to_plane", "colored", "generalized")


def loss(name, scale):
    reg = load_open3d().pipelines.registration
    losses = {"huber": reg.HuberLoss, "tukey": reg.TukeyLoss, "geman_mcclure": reg.GMLoss}
    return losses[name](scale) if name else reg.L2Loss()


def open3d_icp(source, target, T, options):
    reg = load_open3d().pipelines.registration
    criteria = reg.ICPConvergenceCriteria(options.relative_fitness, options.relative_rmse, options.iterations)
    clouds = tr.to_open3d(source), tr.to_open3d(target)
    kernel = loss(options.kernel, options.kernel_scale)
    if options.kind == "colored":
        estimation = reg.TransformationEstimationForColoredICP(1 - options.color_weight, kernel)
        return reg.registration_colored_icp(*clouds, options.max_distance, T.numpy(), estimation, criteria)
    if options.kind == "generalized":
        estimation = reg.TransformationEstimationForGeneralizedICP(EPSILON, kernel)
        return reg.registration_generalized_icp(*clouds, options.max_distance, T.numpy(), estimation, criteria)
    plane = reg.TransformationEstimationPointToPlane(kernel)
    point = reg.TransformationEstimationPointToPoint()
    estimation = plane if options.kind == "point_to_plane" else point
    return reg.registration_icp(*clouds, options.max_distance, T.numpy(), estimation, criteria)


def towards_x(clouds):
    """The same normals but for their signs, so that none is near -x, which Open3D's generalized ICP takes for x."""
    return replace(clouds, normals=torch.where(clouds.normals[:, :1] < 0, -clouds.normals, clouds.normals))


def assert_as_open3d(source, target, T, options, atol=1e-9):
    if options.kind == "generalized":
        source, target = towards_x(source), towards_x(target)
    expected = open3d_icp(source, target, T[0], options)
    found = icp(source, target, T, options)
    assert close(found.T_target_source[0], torch.from_numpy(expected.transformation.copy()), atol=atol)
    assert abs(float(found.fitness) - expected.fitness) < 1e-12
    assert abs(float(found.inlier_rmse) - expected.inlier_rmse) < atol


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_the_result_is_that_of_open3d(start, kind, seed):
    source, target, _, T = start(seed)
    assert_as_open3d(source, target, T, IcpOptions(max_distance=0.2, kind=kind))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("iterations", [1, 2, 7])
def test_every_iterate_is_that_of_open3d(start, kind, iterations):
    source, target, _, T = start(5, degrees=6.0, meters=0.2)
    options = IcpOptions(max_distance=0.4, kind=kind, iterations=iterations, color_weight=0.3)
    assert_as_open3d(source, target, T, options)


@pytest.mark.parametrize("kind", ["point_to_plane", "colored", "generalized"])
@pytest.mark.parametrize(("kernel", "scale"), [("huber", 0.01), ("tukey", 0.05), ("geman_mcclure", 0.01)])
def test_robust_kernels_are_those_of_open3d(start, kind, kernel, scale):
    source, target, _, T = start(1)
    assert_as_open3d(source, target, T, IcpOptions(kind=kind, kernel=kernel, kernel_scale=scale))


def test_points_far_from_their_zero_give_what_open3d_gives(start):
    # a turn about that zero moves them far: the update must be made about the same place
    source, target, _, T = start(2, degrees=0.2, meters=0.02)
    there = T.clone()
    shift = torch.tensor([[300.0, -200.0, 40.0]], dtype=torch.float64)
    there[0, :3, 3] += shift[0]
    far = replace(target, points=target.points + shift)
    assert_as_open3d(source, far, there, IcpOptions(kind="point_to_plane", iterations=3), atol=1e-7)


def test_float32_clouds_give_what_open3d_gives(start):
    source, target, _, T = start(3, dtype=torch.float32)
    assert_as_open3d(source, target, T, IcpOptions(kind="point_to_plane"))


def real_start(name, perturbed):
    if not REAL.exists():
        pytest.skip(f"no real scan pairs at {REAL}")
    pair = next(pair for pair in json.loads((REAL / "pairs.json").read_text())["pairs"] if pair["name"] == name)
    voxel = pair["voxel_m"]
    clouds = (tr.read_cloud(REAL / pair[side], dtype=torch.float64) for side in ("source", "target"))
    source, target = (tr.voxel_downsample(cloud, voxel) for cloud in clouds)
    source, target = (tr.estimate_normals(cloud, tr.neighbors(cloud, 2 * voxel, 30)) for cloud in (source, target))
    # both about their own zeros, so that Open3D sees the same numbers
    T = torch.tensor(pair["T"], dtype=torch.float64)
    T[:3, 3] += T[:3, :3] @ source.origin[0] - target.origin[0]
    zero = torch.zeros_like(source.origin)
    clouds = (replace(cloud, origin=zero, viewpoint=None) for cloud in (source, target))
    return *clouds, (perturbed(0, 2.0, voxel / 2) @ T)[None], voxel


@pytest.mark.real
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["redkitchen_19_05", "ist_office_18_16", "sceaux_outdoor_08_02"])
def test_real_pairs_give_what_open3d_gives(name, kind, perturbed):
    source, target, T, voxel = real_start(name, perturbed)
    assert_as_open3d(source, target, T, IcpOptions(max_distance=1.5 * voxel, kind=kind))


@pytest.mark.real
@pytest.mark.parametrize("kind", ["point_to_point", "point_to_plane", "generalized"])
def test_a_real_pair_without_colors_gives_what_open3d_gives(kind, perturbed):
    source, target, T, voxel = real_start("eth_facade_tls_nocolour_03_06", perturbed)
    assert_as_open3d(source, target, T, IcpOptions(max_distance=1.5 * voxel, kind=kind))
