"""What cannot be refined is data: a reason, the transform it had, never an exception. Bad arguments are refused."""

from dataclasses import replace

import pytest
import torch
from problems import plane_cloud
from refusals import refuses

import torchreg as tr
from torchreg.refinement import IcpLevel, IcpOptions, IcpResult
from torchreg.refinement.icp import icp

EYE = torch.eye(4, dtype=torch.float64)
KINDS = ("point_to_point", "point_to_plane", "colored")


def assert_failed(result, T, *words):
    assert result.converged.tolist() == [False]
    assert all(word in result.reason[0] for word in words), result.reason
    assert torch.equal(result.T_target_source[0].nan_to_num(7), T.nan_to_num(7))


@pytest.mark.parametrize("kind", KINDS)
def test_clouds_far_apart_have_no_correspondences(start, kind):
    source, target, _, T = start(0, 300)
    T[0, 0, 3] += 100
    result = icp(source, target, T, IcpOptions(kind=kind))
    assert_failed(result, T[0], "no correspondences")
    assert result.fitness.tolist() == result.inlier_rmse.tolist() == result.iterations.tolist() == [0]


@pytest.mark.parametrize("kind", ["point_to_plane", "colored"])
def test_a_plane_leaves_the_motion_open(kind):
    flat = plane_cloud(300, 3.0)
    up = torch.tensor([0.0, 0, 1]).expand(300, 3)
    cloud = replace(flat, normals=up, colors=torch.full((300, 3), 0.5))
    result = icp(cloud, cloud, EYE, IcpOptions(kind=kind))
    assert_failed(result, EYE, "leave the motion open")
    assert result.fitness.tolist() == [1]


def test_a_plane_is_enough_for_points_and_for_colors():
    flat = plane_cloud(300, 3.0)
    x, y, _ = flat.points.unbind(1)
    gray = (0.5 + 0.3 * torch.sin(2 * x) * torch.cos(3 * y))[:, None].expand(300, 3)
    cloud = replace(flat, normals=torch.tensor([0.0, 0, 1]).expand(300, 3), colors=gray)
    for kind in ("point_to_point", "colored"):
        assert icp(cloud, cloud, EYE, IcpOptions(kind=kind, max_distance=0.3)).converged.all()


@pytest.mark.parametrize("count", [1, 2, 9])
def test_points_on_a_line_leave_the_motion_open(count):
    line = tr.Clouds(points=torch.arange(float(count))[:, None] * torch.tensor([[0.3, 0.1, -0.2]]))
    assert_failed(icp(line, line, EYE), EYE, "leave the motion open")


@pytest.mark.parametrize("count", [1, 2, 5])
def test_fewer_than_six_planes_leave_the_motion_open(start, count):
    source, target, _, T = start(0, 300)
    few = source.rows(torch.arange(count), torch.tensor([0, count]))
    assert_failed(icp(few, target, T, IcpOptions(kind="point_to_plane", max_distance=5.0)), T[0], "motion open")


@pytest.mark.parametrize("side", ["source", "target"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e200])
def test_points_that_are_not_finite_fail(start, side, bad):
    pair = start(0, 300)
    getattr(pair, side).points[5, 1] = bad
    assert_failed(icp(pair.source, pair.target, pair.T_start), pair.T_start[0], side, "points", "not finite")


def test_normals_that_are_not_finite_fail_where_they_are_needed(start):
    source, target, _, T = start(0, 300)
    target.normals[3] = float("nan")
    assert_failed(icp(source, target, T, IcpOptions(kind="point_to_plane")), T[0], "normals", "not finite")
    assert icp(source, target, T).reason != ("the target has normals that are not finite",)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_start_that_is_not_finite_fails(start, bad):
    source, target, _, T = start(0, 300)
    T[0, 1, 3] = bad
    result = icp(source, target, T)
    assert result.reason == ("the transform to start from is not finite",)


@pytest.mark.parametrize(("row", "column", "value"), [(0, 0, 2.0), (3, 0, 1.0)])
def test_a_start_that_is_not_rigid_is_refused(start, row, column, value):
    source, target, _, T = start(0, 300)
    T[0, row, column] = value
    with refuses("T_target_source"):
        icp(source, target, T)


@pytest.mark.parametrize("side", ["source", "target"])
def test_an_empty_cloud_fails(start, side):
    pair = start(0, 100)
    empty = getattr(pair, side).rows(torch.zeros(0, dtype=torch.int64), torch.tensor([0, 0]))
    pair = pair._replace(**{side: empty})
    assert_failed(icp(pair.source, pair.target, pair.T_start), pair.T_start[0], side, "empty")


def test_voxels_that_cannot_be_numbered_fail_alone(start):
    source, target, _, T = start(0, 300)
    level = IcpLevel(voxel_size=1e-9, max_distance=0.2)
    result = icp(source, target, T, IcpOptions(levels=(level,)))
    assert_failed(result, T[0], "voxel_size")


def test_a_pair_lost_on_the_way_keeps_its_last_transform(start):
    source, target, _, T = start(0, 300)
    level = IcpLevel(max_distance=0.3, iterations=3)
    result = icp(source, target, T, IcpOptions(levels=(level, IcpLevel(max_distance=1e-6))))
    before = icp(source, target, T, IcpOptions(levels=(level,)))
    assert result.reason[0].startswith("no correspondences")
    assert torch.equal(result.T_target_source, before.T_target_source)
    assert result.iterations.tolist() == [3]


def test_running_out_of_iterations_is_said(start):
    source, target, _, T = start(0, 500)
    result = icp(source, target, T, IcpOptions(iterations=2))
    assert result.reason == ("still moving after 2 iterations",)
    assert not torch.equal(result.T_target_source, T)


def test_missing_normals_and_colors_are_refused(start):
    source, target, _, T = start(0, 100)
    bare = tr.Clouds(points=target.points)
    with refuses("target", "normals", "point_to_plane"):
        icp(source, bare, T, IcpOptions(kind="point_to_plane"))
    with refuses("target", "normals", "colored"):
        icp(source, bare, T, IcpOptions(kind="colored"))
    with refuses("target", "colors"):
        icp(source, replace(target, colors=None), T, IcpOptions(kind="colored"))
    with refuses("source", "colors"):
        icp(replace(source, colors=None), target, T, IcpOptions(kind="colored"))


def test_sizes_that_do_not_fit_are_refused(start):
    source, target, _, T = start(0, 100)
    with refuses("target", "1 clouds"):
        icp(source, tr.Clouds.pack([target, target]), T)
    with refuses("T_target_source", "(4, 4)"):
        icp(source, target, T[:, :3])
    with refuses("T_target_source", "(1, 4, 4)"):
        icp(source, target, T.expand(2, 4, 4))
    with refuses("T_target_source", "floating"):
        icp(source, target, T.long())
    with refuses("T_target_source", "tensor"):
        icp(source, target, T.tolist())
    with refuses("options", "one per pair"):
        icp(source, target, T, [IcpOptions()] * 2)
    with refuses("options"):
        icp(source, target, T, [None])
    with refuses("options"):
        icp(source, target, T, 0.2)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_distance", 0.0),
        ("max_distance", float("nan")),
        ("kind", "plane"),
        ("iterations", 0),
        ("relative_fitness", -1.0),
        ("relative_rmse", 0.0),
        ("kernel", "cauchy"),
        ("kernel_scale", 0.0),
        ("color_weight", 1.5),
        ("levels", [IcpLevel()]),
        ("levels", (0.2,)),
    ],
)
def test_options_out_of_range_are_refused(name, value):
    with refuses(name):
        IcpOptions(**{name: value})


@pytest.mark.parametrize(("name", "value"), [("voxel_size", 0.0), ("max_distance", -1.0), ("iterations", 1.5)])
def test_levels_out_of_range_are_refused(name, value):
    with refuses(name):
        IcpLevel(**{name: value})


def test_a_result_checks_its_shapes():
    good = icp(*[tr.Clouds(points=torch.rand(9, 3))] * 2, EYE)
    with refuses("T_target_source"):
        replace(good, T_target_source=EYE)
    with refuses("fitness"):
        replace(good, fitness=good.fitness.float())
    with refuses("failure", "one or None per pair (1)"):
        IcpResult(good.T_target_source, good.fitness, good.inlier_rmse, good.iterations, good.converged, ())
