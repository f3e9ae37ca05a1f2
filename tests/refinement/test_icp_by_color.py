"""Kinds of ICP that search the nearest by place and color: where geometry slides, color holds."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from closeness import close
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_transform, seeded
from refusals import refuses

import torchreg as tr
from torchreg.geometry.se3 import inverse
from torchreg.native import native_kernels
from torchreg.refinement import IcpLevel, levels
from torchreg.refinement.color_axes import hue_circle, lab
from torchreg.refinement.metric_search import MetricSearch

EYE = torch.eye(4, dtype=torch.float64)
BY_COLOR = ("colored_generalized", "hue_point_to_point")
BY_SHAPE = {"colored_generalized": "generalized", "hue_point_to_point": "point_to_point"}
every_kind = pytest.mark.parametrize("kind", BY_COLOR)


def painted(x, y):
    """Bright colors (P, 3) that change over decimeters along both sides of a wall."""
    waves = torch.stack([torch.sin(4 * x + 1), torch.sin(5 * y), torch.cos(3 * (x + y))], dim=1)
    return 0.5 + 0.4 * waves


def wall(count, seed):
    """A painted square of 2 m, drawn evenly, with a millimeter of noise."""
    generator = seeded(seed)
    x, y = 2 * torch.rand(2, count, generator=generator, dtype=torch.float64)
    z = 0.001 * torch.randn(count, generator=generator, dtype=torch.float64)
    normals = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).expand(count, 3)
    return tr.Clouds(points=torch.stack([x, y, z], dim=1), colors=painted(x, y), normals=normals)


def slid(by):
    T = EYE.clone()
    T[:2, 3] = torch.tensor(by, dtype=torch.float64)
    return T


@every_kind
def test_a_painted_wall_is_held_along_itself(kind):
    source, target = wall(1500, 1), wall(1500, 2)
    by = (0.04, -0.05)
    options = tr.IcpOptions(kind=kind, max_distance=0.3, iterations=60, color_scale=1.0)
    without = replace(options, kind=BY_SHAPE[kind])
    held, free = (
        tr.icp(source, target, slid(by), each).T_target_source[0, :2, 3].norm() for each in (options, without)
    )
    assert float(free) > 0.02
    assert float(held) < 0.2 * float(free)


@every_kind
def test_the_truth_is_found(start, kind):
    source, target, truth, T = start(0, count=1500, degrees=3.0, meters=0.08)
    result = tr.icp(source, target, T, tr.IcpOptions(max_distance=0.3, kind=kind, iterations=60))
    apart = [float(tr.metrics.rmse(truth, found, source.points)) for found in (T, result.T_target_source)]
    assert apart[0] > 0.05
    assert apart[1] < (0.02 if kind == "hue_point_to_point" else 0.01)


@every_kind
def test_a_moved_copy_is_moved_back(kind):
    target = wall(900, 3)
    truth = random_transform(seeded(4))
    source = tr.transform(target, inverse(truth))
    options = tr.IcpOptions(kind=kind, max_distance=0.3, relative_rmse=1e-12, iterations=100)
    result = tr.icp(source, target, slid((0.02, 0.01)) @ truth, options)
    assert close(result.T_target_source[0], truth, atol=1e-8)


@every_kind
def test_one_color_changes_no_correspondence(start, kind):
    source, target, _, T = start(1, count=900)
    gray = [replace(cloud, colors=torch.full_like(cloud.points, 0.4)) for cloud in (source, target)]
    options = tr.IcpOptions(kind=kind, max_distance=0.3)
    one = tr.icp(*gray, T, options)
    other = tr.icp(*gray, T, replace(options, kind=BY_SHAPE[kind]))
    assert close(one.T_target_source, other.T_target_source, atol=1e-12)
    assert torch.equal(one.fitness, other.fitness)
    assert close(one.inlier_rmse, other.inlier_rmse, atol=1e-12)


@every_kind
def test_rmse_is_in_space_and_fitness_falls_with_the_scale_of_color(start, kind):
    source, target, truth, _ = start(2, count=900)
    near, far = (
        tr.icp(source, target, truth, tr.IcpOptions(kind=kind, max_distance=0.3, iterations=1, color_scale=scale))
        for scale in (1e-6, 5.0)
    )
    plain = tr.icp(source, target, truth, tr.IcpOptions(kind=BY_SHAPE[kind], max_distance=0.3, iterations=1))
    assert close(near.inlier_rmse, plain.inlier_rmse, atol=1e-6)
    assert float(far.fitness) < float(near.fitness)
    assert float(far.inlier_rmse) < 0.3


@every_kind
def test_a_batch_equals_the_loop_with_scales_of_its_own(start, kind):
    pairs = [start(seed, count=count) for seed, count in ((0, 500), (1, 900))]
    options = [tr.IcpOptions(kind=kind, max_distance=0.3, iterations=4, color_scale=scale) for scale in (None, 0.1)]
    both = tr.icp(
        tr.Clouds.pack([pair.source for pair in pairs]),
        tr.Clouds.pack([pair.target for pair in pairs]),
        torch.cat([pair.T_start for pair in pairs]),
        options,
    )
    for b, (pair, option) in enumerate(zip(pairs, options, strict=True)):
        alone = tr.icp(pair.source, pair.target, pair.T_start, option)
        assert same_bits(both[b], alone)


@every_kind
def test_the_default_scale_is_the_largest_distance_of_the_level(start, kind):
    source, target, _, T = start(3, count=700)
    levels = tuple(IcpLevel(max_distance=reach, iterations=3) for reach in (0.4, 0.2))
    coarse = tr.icp(source, target, T, tr.IcpOptions(kind=kind, levels=levels[:1], color_scale=0.4))
    fine = tr.icp(source, target, coarse.T_target_source, tr.IcpOptions(kind=kind, levels=levels[1:], color_scale=0.2))
    both = tr.icp(source, target, T, tr.IcpOptions(kind=kind, levels=levels))
    assert close(both.T_target_source, fine.T_target_source, atol=1e-12)


@every_kind
def test_kernels_do_not_show(start, kind):
    source, target, _, T = start(4, count=700)
    options = tr.IcpOptions(kind=kind, max_distance=0.3, iterations=5)
    with native_kernels(False):
        slow = tr.icp(source, target, T, options)
    fast = tr.icp(source, target, T, options)
    assert torch.equal(fast.fitness, slow.fitness)
    assert close(fast.T_target_source, slow.T_target_source, atol=1e-12)


@every_kind
def test_what_is_missing_is_named(start, kind):
    source, target, _, T = start(5, count=300)
    for side in ("source", "target"):
        given = {"source": source, "target": target}
        given[side] = replace(given[side], colors=None)
        with refuses(side, "colors", kind):
            tr.icp(**given, T_target_source=T, options=tr.IcpOptions(kind=kind))
    with refuses("color_scale"):
        tr.IcpOptions(kind=kind, color_scale=0.0)
    broken = source.colors.clone()
    broken[3] = torch.nan
    result = tr.icp(replace(source, colors=broken), target, T, tr.IcpOptions(kind=kind))
    assert result.failure[0].kind == "not finite"


def brute_force(queries, points, count):
    square = (queries[:, None] - points).square().sum(dim=2)
    return square.sort(dim=1, stable=True).indices[:, :count]


@given(
    st.integers(0, 2**31), st.integers(1, 200), st.integers(4, 7), st.sampled_from([0.0, 0.1, 1.0, 30.0]), st.booleans()
)
@settings(max_examples=30, deadline=None)
def test_the_nearest_in_all_dimensions_are_found(seed, count, axes, spread, compiled):
    generator = seeded(seed)
    scale = torch.tensor([1.0, 1.0, 1.0] + [spread] * (axes - 3), dtype=torch.float64)
    points, queries = (scale * torch.rand(n, axes, generator=generator, dtype=torch.float64) for n in (count, 40))
    queries[:10, :3] += 50.0
    with native_kernels(compiled):
        found = MetricSearch(points, 4)(queries)
    assert torch.equal(found.rows, brute_force(queries, points, 4))


@given(st.integers(0, 2**31), st.integers(65, 600), st.sampled_from([0.0, 0.03, 0.2, 1.0]), st.booleans())
@settings(max_examples=30, deadline=None)
def test_what_is_nearer_than_the_limit_is_found_and_all_else_is_bounded(seed, count, limit, compiled):
    generator = seeded(seed)
    points, queries = (torch.rand(n, 6, generator=generator, dtype=torch.float64) for n in (count, 60))
    points[:, 2], queries[:20] = 0.0, points[:20]
    queries[:20, 5] += 0.3
    queries[20:30, :3] += 2.0
    with native_kernels(compiled):
        rows, beyond = MetricSearch(points, 4, limit)(queries)
    expected = brute_force(queries, points, 4)
    apart = (queries[:, None] - points).norm(dim=2)
    wanted = apart.gather(1, expected) < limit
    assert torch.equal(rows[wanted], expected[wanted])
    assert bool((rows.sort(dim=1).values.diff(dim=1) > 0).all())
    bound = torch.minimum(beyond, apart.gather(1, rows[:, -1:])[:, 0])
    others = apart.scatter(1, rows, torch.inf)
    assert bool((others.amin(dim=1) >= bound * (1 - 1e-9)).all())
    assert bool((bound >= torch.minimum(apart.gather(1, expected[:, -1:])[:, 0], torch.tensor(limit))).all())


@every_kind
@pytest.mark.parametrize(("far", "scale"), [(0.5, 0.3), (0.0, 2.0)])
def test_what_has_no_partner_costs_no_look_at_all_points(kind, far, scale, monkeypatch):
    count, looked = 2000, []
    source, target = wall(count, 5), wall(count, 6)
    source = replace(source, colors=(source.colors + 0.2).clamp(max=1.0), points=source.points + far)
    ranked = MetricSearch._ranked

    def counted(self, queries, rows):
        looked.append(rows.numel())
        return ranked(self, queries, rows)

    monkeypatch.setattr(MetricSearch, "_ranked", counted)
    tr.icp(source, target, EYE, tr.IcpOptions(kind=kind, max_distance=0.3, iterations=1, color_scale=scale))
    assert 0 < sum(looked) < count * count / 4


@every_kind
def test_the_limit_of_the_search_changes_no_result(kind, monkeypatch):
    source, target = wall(900, 7), wall(900, 8)
    source = replace(source, colors=(source.colors + 0.15).clamp(max=1.0), points=source.points + 0.02)
    options = tr.IcpOptions(kind=kind, max_distance=0.1, iterations=8, color_scale=0.5)
    limited = tr.icp(source, target, EYE, options)
    assert 0 < float(limited.fitness) < 1
    monkeypatch.setattr(levels, "MetricSearch", lambda points, count, limit: MetricSearch(points, count))
    assert same_bits(limited, tr.icp(source, target, EYE, options))


def test_of_equally_near_points_the_lower_rows_come_first():
    points = torch.zeros(300, 5, dtype=torch.float64)
    points[200:, 4] = 1.0
    found = MetricSearch(points, 4)(torch.tensor([[0.0, 0, 0, 0, 1.0], [0.0, 0, 0, 0, 0.2]], dtype=torch.float64))
    assert found.rows.tolist() == [[200, 201, 202, 203], [0, 1, 2, 3]]


def colors(*rows):
    values = torch.tensor(rows, dtype=torch.float64)
    return tr.Clouds(points=torch.zeros(len(rows), 3, dtype=torch.float64), colors=values)


def test_lab_is_that_of_kornia_and_of_the_white_point():
    from kornia.color import rgb_to_lab

    values = torch.rand(500, 3, generator=seeded(1), dtype=torch.float64)
    values[:200] *= 0.05
    expected = rgb_to_lab(values.t()[None, :, :, None])[0, :, :, 0].t() / 100
    assert close(lab(colors(*values.tolist())), expected, atol=5e-4)  # whose matrix has fewer digits
    found = lab(colors((0, 0, 0), (1, 1, 1), (2, 2, 2)))
    assert close(found[0], torch.zeros(3, dtype=torch.float64), atol=1e-9)
    assert close(found[1], torch.tensor([1.0, 0, 0], dtype=torch.float64), atol=2e-4)
    assert torch.equal(found[1], found[2])


def test_hue_is_circular_and_gray_lies_in_the_middle():
    from kornia.color import rgb_to_hsv

    values = torch.rand(500, 3, generator=seeded(2), dtype=torch.float64)
    circle = hue_circle(colors(*values.tolist()))
    hue = rgb_to_hsv(values.t()[None, :, :, None])[0, 0, :, 0]
    angle = torch.atan2(circle[:, 1], circle[:, 0])
    turn = torch.remainder(angle - hue + torch.pi, 2 * torch.pi) - torch.pi
    assert float(turn.abs().max()) < torch.deg2rad(torch.tensor(1.2))
    assert close(circle.norm(dim=1), torch.full((500,), 0.5, dtype=torch.float64), atol=1e-12)
    red, cyan, gray, dim = hue_circle(colors((1, 0, 0), (0, 1, 1), (0.3, 0.3, 0.3), (0.1, 0, 0)))
    assert close((red - cyan).norm(), torch.tensor(1.0, dtype=torch.float64), atol=1e-12)
    assert gray.tolist() == [0, 0]
    assert close(red, dim, atol=1e-12)


def test_colors_round_alike_in_any_batch():
    values = torch.rand(1003, 3, generator=seeded(3), dtype=torch.float64)
    for axes in (lab, hue_circle):
        whole = axes(colors(*values.tolist()))
        assert same_bits(torch.cat([axes(colors(*part.tolist())) for part in values.split(7)]), whole)
