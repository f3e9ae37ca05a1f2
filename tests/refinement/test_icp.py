"""ICP by its properties: the truth found, the same bits in any batch, origins that cost nothing."""

from dataclasses import replace
from importlib import import_module

import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_transform, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.geometry.se3 import inverse
from torchreg.refinement import IcpLevel, IcpOptions
from torchreg.refinement.correspond import all_pairs
from torchreg.refinement.icp import icp
from torchreg.refinement.options import KINDS as RECORDS
from torchreg.refinement.point_to_plane import POINT_TO_PLANE

EYE = torch.eye(4, dtype=torch.float64)
KINDS = ("point_to_point", "point_to_plane", "colored", "generalized", "colored_generalized", "hue_point_to_point")


def with_normals(cloud):
    return tr.estimate_normals(cloud, tr.neighbors(cloud, 0.5, 30))


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_is_found(start, kind):
    source, target, truth, T = start(0, degrees=3.0, meters=0.08)
    result = icp(source, target, T, IcpOptions(max_distance=0.3, kind=kind, iterations=60))
    apart = [float(tr.metrics.rmse(truth, found, source.points)) for found in (T, result.T_target_source)]
    assert apart[0] > 0.05
    assert apart[1] < (0.02 if kind.endswith("point_to_point") else 0.01)
    assert result.fitness > 0.75


def test_a_kind_from_outside_is_one_record(start, monkeypatch):
    source, target, _, T = start(1)

    def estimator(kernel):
        halved = POINT_TO_PLANE.estimator(lambda residual, scale: 0.5 * kernel(residual, scale))
        return halved._replace(solve=lambda sums, center: halved.solve(2 * sums, center))

    monkeypatch.setitem(RECORDS, "mine", POINT_TO_PLANE._replace(estimator=estimator))
    mine, known = (icp(source, target, T, IcpOptions(kind=kind)) for kind in ("mine", "point_to_plane"))
    assert same_bits(mine, known)
    with refuses("target", "normals", "'mine'"):
        icp(source, replace(target, normals=None), T, IcpOptions(kind="mine"))


@given(st.integers(0, 2**31))
@settings(max_examples=10)
def test_a_moved_copy_is_moved_back(seed):
    generator = torch.Generator().manual_seed(seed)
    target = with_normals(sphere_cloud(400, seed=seed % 100))
    truth = random_transform(generator)
    source = tr.transform(target, inverse(truth))
    near = torch.eye(4, dtype=torch.float64)
    near[:3, 3] = 0.01 * torch.randn(3, dtype=torch.float64, generator=generator)
    for kind in KINDS:
        options = IcpOptions(kind=kind, max_distance=0.3, relative_rmse=1e-12)
        result = icp(source, target, (near @ truth)[None], options)
        assert close(result.T_target_source[0], truth, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_identical_clouds_stay_where_they_are(start, kind):
    target = start(0).target
    result = icp(target, target, EYE, IcpOptions(kind=kind))
    assert close(result.T_target_source[0], EYE, atol=1e-13)
    assert result.converged.tolist() == [True]
    assert result.iterations.tolist() == [1]
    assert result.fitness.tolist() == [1]
    assert result.inlier_rmse < 1e-13


def test_swapped_clouds_give_about_the_inverse(start):
    source, target, _, T = start(1)
    source = with_normals(source)
    options = IcpOptions(kind="point_to_plane")
    forth = icp(source, target, T, options).T_target_source[0]
    back = icp(target, source, inverse(T), options).T_target_source[0]
    assert close(forth @ back, EYE, atol=5e-3)


def batch_of_pairs(start):
    """Pairs of several sizes, with failing ones among them."""
    pairs = [start(seed, count) for seed, count in ((0, 900), (1, 300), (2, 1500))]
    broken = start(3, 200)
    broken.source.points[7] = float("nan")
    lost = start(4, 250)
    lost.T_start[0, :3, 3] += 100
    return [pairs[0], broken, pairs[1], lost, pairs[2]]


def run_batch(pairs, options):
    source, target = (tr.Clouds.pack([getattr(pair, side) for pair in pairs]) for side in ("source", "target"))
    return icp(source, target, torch.cat([pair.T_start for pair in pairs]), options)


def pair_of(result, b):
    values = (result.T_target_source, result.fitness, result.inlier_rmse, result.iterations, result.converged)
    return *(value[b].clone() for value in values), result.reason[b]


@pytest.mark.parametrize("kind", KINDS)
def test_a_batch_equals_the_loop_over_its_pairs(start, kind):
    pairs = batch_of_pairs(start)
    each = [
        IcpOptions(kind=kind, max_distance=distance, iterations=count, kernel="huber", kernel_scale=0.02)
        for distance, count in ((0.3, 30), (0.2, 30), (0.25, 2), (0.2, 9), (0.4, 13))
    ]
    together = run_batch(pairs, each)
    assert [not reason or reason.startswith("still") for reason in together.reason] == [True, False, True, False, True]
    for b, (pair, options) in enumerate(zip(pairs, each, strict=True)):
        alone = icp(pair.source, pair.target, pair.T_start, options)
        assert same_bits(pair_of(together, b), pair_of(alone, 0))


@pytest.mark.parametrize("kind", KINDS)
def test_the_number_of_threads_does_not_show(start, kind):
    pairs = batch_of_pairs(start)
    expected = run_batch(pairs, IcpOptions(kind=kind))
    for number in THREADS:
        with threads(number):
            assert same_bits(run_batch(pairs, IcpOptions(kind=kind)), expected)


def test_pairs_of_several_kinds_go_in_one_batch(start):
    pairs = [start(seed, 400) for seed in range(len(KINDS))]
    each = [IcpOptions(kind=kind) for kind in KINDS]
    each[3] = replace(each[3], levels=(IcpLevel(max_distance=0.4), IcpLevel(max_distance=0.2)))
    together = run_batch(pairs, each)
    for b, (pair, options) in enumerate(zip(pairs, each, strict=True)):
        assert same_bits(pair_of(together, b), pair_of(icp(pair.source, pair.target, pair.T_start, options), 0))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_origins_of_utm_size_lose_nothing(start, kind, dtype):
    source, target, _, T = start(0, dtype=dtype)
    options = IcpOptions(kind=kind)
    near = icp(source, target, T, options)
    at = torch.tensor([[5e5, 5.4e6, 300.0]], dtype=torch.float64)
    to = torch.tensor([[4.2e5, 3.3e6, -20.0]], dtype=torch.float64)
    away = T.clone()
    away[0, :3, 3] += to[0] - T[0, :3, :3] @ at[0]
    far = icp(replace(source, origin=at), replace(target, origin=to), away, options)
    back = far.T_target_source.clone()
    back[0, :3, 3] += back[0, :3, :3] @ at[0] - to[0]
    assert close(back, near.T_target_source, atol=1e-7)
    assert close(far.inlier_rmse, near.inlier_rmse, atol=1e-8)
    assert far.fitness.tolist() == near.fitness.tolist()


@pytest.mark.parametrize("kind", KINDS)
def test_the_search_of_other_devices_gives_the_same_bits(start, kind, monkeypatch):
    source, target, _, T = start(0, 600)
    by_tree = icp(source, target, T, IcpOptions(kind=kind))
    monkeypatch.setattr(import_module("torchreg.refinement.levels"), "few_nearest", all_pairs)
    assert same_bits(icp(source, target, T, IcpOptions(kind=kind)), by_tree)


def test_fitness_and_rmse_are_those_of_the_metrics(start):
    source, target, _, T = start(0)
    result = icp(source, target, T, IcpOptions(max_distance=0.15))
    found = result.T_target_source
    assert result.fitness.tolist() == tr.metrics.fitness(source, target, found, 0.15).tolist()
    assert close(result.inlier_rmse, tr.metrics.inlier_rmse(source, target, found, 0.15), atol=1e-12)


def test_levels_reach_further_than_one_level(start):
    source, target, truth, T = start(0, degrees=12.0, meters=0.4)
    fine = IcpOptions(kind="point_to_plane", max_distance=0.1)
    coarse = [IcpLevel(voxel_size=0.3, max_distance=1.0), IcpLevel(voxel_size=0.15, max_distance=0.4)]
    levels = replace(fine, levels=(*coarse, IcpLevel(max_distance=0.1)))
    alone, steps = (icp(source, target, T, options) for options in (fine, levels))
    apart = [float(tr.metrics.rmse(truth, found.T_target_source, source.points)) for found in (alone, steps)]
    assert apart[1] < 0.01 < apart[0]
    assert steps.converged.tolist() == [True]


def test_one_level_is_the_options_themselves(start):
    source, target, _, T = start(0)
    plain = icp(source, target, T, IcpOptions(max_distance=0.3, iterations=4))
    level = IcpLevel(max_distance=0.3, iterations=4)
    assert same_bits(icp(source, target, T, IcpOptions(levels=(level,))), plain)


def test_iterations_of_all_levels_count(start):
    source, target, _, T = start(0)
    level = IcpLevel(max_distance=0.3, iterations=2)
    result = icp(source, target, T, IcpOptions(levels=(level, replace(level, voxel_size=0.1), level)))
    assert result.iterations.tolist() == [6]
    assert result.converged.tolist() == [False]
    assert result.reason == ("still moving after 2 iterations",)


def test_kernels_hold_off_outliers(start):
    source, target, truth, _ = start(0)
    generator = torch.Generator().manual_seed(0)
    ghost = target.points[::4] + 0.15 * torch.rand(len(target.points[::4]), 3, dtype=torch.float64, generator=generator)
    noisy = tr.Clouds(points=torch.cat([source.points, (ghost - truth[0, :3, 3]) @ truth[0, :3, :3]]))
    for kind in ("point_to_point", "point_to_plane"):
        plain, robust = (
            icp(noisy, target, truth, IcpOptions(kind=kind, kernel=kernel, kernel_scale=0.06, iterations=60))
            for kernel in (None, "tukey")
        )
        apart = [float(tr.metrics.rmse(truth, found.T_target_source, source.points)) for found in (plain, robust)]
        assert apart[1] < apart[0]


def test_inputs_are_detached_and_left_alone(start):
    source, target, _, T = start(0, 200)
    before = source.points.clone(), target.points.clone(), T.clone()
    source = replace(source, points=source.points.requires_grad_())
    result = icp(source, target, T.requires_grad_(), IcpOptions(kind="colored"))
    assert not result.T_target_source.requires_grad
    assert all(map(torch.equal, before, (source.points, target.points, T)))


def test_an_empty_batch_gives_an_empty_result():
    none = tr.Clouds(points=torch.zeros(0, 3), offsets=torch.tensor([0]), normals=torch.zeros(0, 3))
    result = icp(none, none, torch.zeros(0, 4, 4), IcpOptions(kind="point_to_plane"))
    assert len(result) == 0
    assert result.reason == ()
