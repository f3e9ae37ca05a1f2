"""The pieces of ICP against naive twins: searches that are skipped, sums in blocks, weights, gradients of color."""

import numpy as np
import pytest
import torch
from closeness import close
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_rotation, random_transform, sphere_cloud

import torchreg as tr
from torchreg.geometry.se3 import apply_rotation
from torchreg.open3d_loader import load_open3d
from torchreg.refinement.blocks import BLOCK, Blocks
from torchreg.refinement.colored import color_gradient, tangents
from torchreg.refinement.correspond import FEW, Correspondence, Target, all_pairs, few_nearest
from torchreg.refinement.gauss_newton import rotation_zyx
from torchreg.refinement.kernels import KERNELS
from torchreg.refinement.tree_correspond import correspondences


def correspondence(source, target, max_distance, make=Correspondence, search=few_nearest):
    blocks = Blocks.of([len(cloud) for cloud in source], source[0].device)
    first = np.cumsum([0, *(len(cloud) for cloud in target[:-1])]).tolist()
    packed = Target(torch.cat(target).t().contiguous(), tuple(first), tuple(map(search, target)))
    limit = torch.full((len(source),), max_distance, dtype=torch.float64)
    return make(blocks, blocks.fill(torch.cat(source)), packed, limit)


def assert_full_search(found, source, target, R, t, max_distance):
    """Everything the correspondences say is what comparing all pairs says."""
    begin = 0
    for b, count in zip(found.pairs, found.blocks.counts, strict=True):
        rows = slice(begin * BLOCK, begin * BLOCK + len(source[b]))
        begin += count
        moved = apply_rotation(R[b], source[b]) + t[b]
        nearest, row = torch.cdist(moved, target[b], compute_mode="donot_use_mm_for_euclid_dist").min(dim=1)
        inside = found.inside.view(-1)[rows]
        assert torch.equal(inside, nearest < max_distance)
        assert close(found.square.view(-1)[rows][inside], nearest[inside] ** 2, atol=1e-12)
        assert torch.equal(found.partner.view(3, -1)[:, rows].t()[inside], target[b][row][inside])


@pytest.mark.parametrize("make", [Correspondence, correspondences])
@given(st.integers(0, 2**31), st.floats(0, 0.3), st.sampled_from([0.05, 0.3, 5.0]))
@settings(max_examples=25)
def test_searches_that_are_skipped_change_nothing(make, seed, step, max_distance):
    generator = torch.Generator().manual_seed(seed)

    def cloud(count):
        return torch.rand(count, 3, dtype=torch.float64, generator=generator)

    source, target = [cloud(300), cloud(20), cloud(257)], [cloud(150), cloud(2), cloud(1)]
    found = correspondence(source, target, max_distance, make)
    R = torch.eye(3, dtype=torch.float64).repeat(3, 1, 1)
    t = torch.zeros(3, 3, dtype=torch.float64)
    for turn in range(6):
        found.move(R[found.pairs], t[found.pairs])
        assert_full_search(found, source, target, R, t, max_distance)
        if turn == 3:
            found.keep([0, 2])
            found.narrow(0.5 * found.max_distance)
            max_distance *= 0.5
        angles, shift = torch.randn(2, 3, 3, dtype=torch.float64, generator=generator)
        R = rotation_zyx(step * angles) @ R
        t = t + step * shift


def test_small_steps_need_few_searches(monkeypatch):
    source, target = (sphere_cloud(2000, seed=seed).points for seed in (0, 1))
    found = correspondence([source], [target], 0.5)
    searched = []
    search = found._search
    monkeypatch.setattr(found, "_search", lambda rows: (searched.append(len(rows)), search(rows)))
    R = torch.eye(3, dtype=torch.float64)[None]
    for step in range(5):
        found.move(R, torch.full((1, 3), 1e-4 * step, dtype=torch.float64))
    assert searched[0] == 2000
    assert max(searched[1:]) < 20


@pytest.mark.parametrize("count", [1, 2, 3, 4, 200])
def test_comparing_all_pairs_finds_what_the_tree_finds(count):
    generator = torch.Generator().manual_seed(count)
    points, queries = (torch.rand(n, 3, dtype=torch.float64, generator=generator) for n in (count, 70))
    expected = few_nearest(points)(queries).rows
    assert expected.shape == (70, min(FEW, count))
    for max_bytes in (1, 2**14, 2**30):
        assert torch.equal(all_pairs(points, max_bytes)(queries).rows, expected.long())


@given(st.lists(st.integers(1, 1500), min_size=1, max_size=5), st.integers(0, 100))
@settings(max_examples=25)
def test_sums_over_blocks_are_right_and_the_same_bits_alone(lengths, seed):
    values = torch.randn(sum(lengths), 2, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    blocks = Blocks.of(lengths, values.device)
    filled = blocks.fill(values)
    together = blocks.sums(lambda chunk: filled[:, chunk], 2)
    for b, part in enumerate(values.split(lengths)):
        assert close(together[b], part.sum(dim=0), atol=1e-11)
        single = Blocks.of([lengths[b]], values.device)
        alone = single.fill(part)
        assert same_bits(single.sums(lambda chunk, alone=alone: alone[:, chunk], 2)[0].clone(), together[b].clone())
        kept, chosen = blocks.keep([b])
        assert same_bits(kept.real, single.real)
        assert same_bits(filled[:, chosen], alone)


@pytest.mark.parametrize("name", ["huber", "tukey", "geman_mcclure"])
def test_weights_are_those_of_open3d(name):
    reg = load_open3d().pipelines.registration
    loss = {"huber": reg.HuberLoss, "tukey": reg.TukeyLoss, "geman_mcclure": reg.GMLoss}[name](0.3)
    residual = torch.linspace(-2, 2, 81, dtype=torch.float64)
    expected = torch.tensor([loss.weight(r) for r in residual.tolist()], dtype=torch.float64)
    assert close(KERNELS[name](residual, torch.tensor(0.3, dtype=torch.float64)), expected, atol=1e-14)


def test_a_rotation_turns_about_x_then_y_then_z():
    a, b, c = torch.tensor([0.3, -0.5, 0.7], dtype=torch.float64)
    zero = torch.zeros((), dtype=torch.float64)
    about = [rotation_zyx(torch.stack(row)[None])[0] for row in ((a, zero, zero), (zero, b, zero), (zero, zero, c))]
    together = rotation_zyx(torch.stack([a, b, c])[None])[0]
    assert close(together, about[2] @ about[1] @ about[0], atol=1e-15)
    assert close(about[2][:2, 0], torch.stack([c.cos(), c.sin()]), atol=1e-15)


def naive_gradient(cloud, intensity, radius):
    """Open3D's least squares, row by row, with its solver's own unknowns."""
    near = tr.neighbors(cloud, radius, 30)
    points, normals, values = cloud.points.numpy(), cloud.normals.numpy(), intensity.numpy()
    out = np.zeros_like(points)
    for k, (index, valid) in enumerate(zip(near.index.numpy(), near.valid.numpy(), strict=True)):
        index = index[valid]
        if len(index) >= 4:
            A = np.vstack([points[index] - points[k], (len(index) - 1) * normals[k]])
            out[k] = np.linalg.lstsq(A, np.append(values[index] - values[k], 0), rcond=None)[0]
    return torch.from_numpy(out)


def gradient_of(cloud, intensity, radius):
    return color_gradient(cloud, cloud.normals, intensity, torch.tensor([radius], dtype=torch.float64))


def test_the_gradient_of_color_is_that_of_least_squares():
    cloud = sphere_cloud(700)
    intensity = cloud.colors.mean(dim=1)
    expected = naive_gradient(cloud, intensity, 0.25)
    assert (expected == 0).all(dim=1).any()
    assert close(gradient_of(cloud, intensity, 0.25), expected, atol=1e-9)


def test_a_linear_color_on_a_plane_has_its_slope():
    T = random_transform(torch.Generator().manual_seed(0))
    flat = torch.rand(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    flat[:, 2] = 0
    points = flat @ T[:3, :3].t() + T[:3, 3]
    cloud = tr.Clouds(points=points, normals=T[:3, 2].expand(200, 3).contiguous())
    slope = T[:3, :3] @ torch.tensor([0.3, -0.2, 0.0], dtype=torch.float64)
    assert close(gradient_of(cloud, points @ slope, 0.4), slope.expand(200, 3), atol=1e-9)


def test_neighbors_on_a_line_have_no_gradient():
    line = torch.arange(9.0, dtype=torch.float64)[:, None] * torch.tensor([[1.0, 0, 0]], dtype=torch.float64)
    cloud = tr.Clouds(points=line, normals=torch.tensor([0.0, 0, 1], dtype=torch.float64).expand(9, 3))
    assert not gradient_of(cloud, line[:, 0], 5.0).any()


@given(st.integers(0, 2**31))
def test_tangents_make_a_right_handed_basis(seed):
    basis = random_rotation(torch.Generator().manual_seed(seed))
    normals = torch.cat([basis, -basis, torch.eye(3, dtype=torch.float64), -torch.eye(3, dtype=torch.float64)])
    first, second = tangents(normals.t())
    whole = torch.stack([first, second, normals.t()], dim=1).permute(2, 0, 1)  # (12, 3, 3), columns
    assert close(whole.transpose(1, 2) @ whole, torch.eye(3, dtype=torch.float64).expand(12, 3, 3), atol=1e-12)
    assert (torch.linalg.det(whole) > 0).all()
