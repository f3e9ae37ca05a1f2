"""ICP by compiled kernels has the bits of ICP by torch."""

import pytest
import torch
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_transform

import torchreg as tr
from torchreg.native import native_kernels, native_library
from torchreg.refinement.gauss_newton import CHANNELS, products, solve
from torchreg.refinement.icp import refine_pairs
from torchreg.refinement.pairing import Pairing

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")

FIELDS = ("T_target_source", "fitness", "inlier_rmse", "iterations", "converged")


def cloud(count, generator, flat=False, repeats=True):
    """Points of a box or of a plane, some of which coincide."""
    points = torch.rand(count, 3, dtype=torch.float64, generator=generator)
    if flat:
        points[:, 2] = 0
    if repeats:
        points[: count // 9] = points[count // 3 : count // 3 + count // 9].clone()
    normals = torch.nn.functional.normalize(torch.randn(count, 3, dtype=torch.float64, generator=generator), dim=1)
    if flat:
        normals = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(count, 3).contiguous()
    normals[: count // 20] = 0
    colors = torch.rand(count, 3, dtype=torch.float64, generator=generator)
    return tr.Clouds(points=points, normals=normals, colors=colors)


def refined(arguments, threads, compiled):
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(threads)
        with native_kernels(compiled):
            return refine_pairs(*arguments)
    finally:
        torch.set_num_threads(before)


def assert_same(arguments, threads=(1, 2, 3)):
    expected = refined(arguments, 1, False)
    for number in threads:
        result = refined(arguments, number, True)
        assert result.reason == expected.reason
        for name in FIELDS:
            assert same_bits(getattr(result, name), getattr(expected, name)), name
    return expected


@given(
    st.lists(st.integers(1, 900), min_size=1, max_size=3),
    st.lists(st.integers(1, 700), min_size=1, max_size=2),
    st.floats(0, 0.4),
    st.sampled_from([0.01, 0.1, 0.4, 9.0]),
    st.sampled_from(["point_to_plane", "point_to_point", "colored", "generalized"]),
    st.integers(0, 2**31),
)
@settings(max_examples=40, deadline=None)
def test_it_has_the_bits_of_torch(sources, targets, off, max_distance, kind, seed):
    generator = torch.Generator().manual_seed(seed)
    # where points coincide, neighborhoods of colors may be cut otherwise by Open3D's tree
    shape = {"flat": seed % 5 == 0, "repeats": kind != "colored"}
    source, target = (
        tr.Clouds.pack([cloud(count, generator, **shape) for count in counts]) for counts in (sources, targets)
    )
    pairing = Pairing([b % len(sources) for b in range(5)], [b % len(targets) for b in range(5)])
    T = torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
    T[1:3] = torch.stack([random_transform(generator) for _ in range(2)])
    T[:, :3, 3] += off * torch.randn(5, 3, dtype=torch.float64, generator=generator)
    options = [tr.IcpOptions(kind=kind, max_distance=max_distance, iterations=7)] * 5
    assert_same((source, target, pairing, T, options))


@pytest.mark.parametrize("kernel", ["huber", "tukey", "geman_mcclure"])
def test_robust_kernels_have_the_bits_of_torch(kernel):
    generator = torch.Generator().manual_seed(0)
    source, target = cloud(700, generator), cloud(500, generator)
    options = tr.IcpOptions(kind="point_to_plane", kernel=kernel, kernel_scale=0.05, max_distance=0.2)
    T = torch.eye(4, dtype=torch.float64)[None]
    assert_same((source, target, Pairing([0], [0]), T, [options]))


def test_large_pairs_are_shared_among_threads_with_the_same_bits():
    generator = torch.Generator().manual_seed(3)
    source, target = cloud(45_000, generator), cloud(4000, generator)
    options = [tr.IcpOptions(kind="point_to_plane", max_distance=0.05, iterations=3)]
    expected = assert_same((source, target, Pairing([0], [0]), torch.eye(4, dtype=torch.float64)[None], options))
    assert expected.fitness > 0.5


@given(st.integers(0, 2**31), st.sampled_from([0, 1, 5, 40]))
@settings(max_examples=25, deadline=None)
def test_the_update_has_the_bits_of_torch(seed, pairs):
    generator = torch.Generator().manual_seed(seed)
    rows = torch.randn(7, pairs, 256, dtype=torch.float64, generator=generator)
    rows[seed % 6, : pairs // 3] = 0
    rows[1, pairs // 3 : pairs // 2] = rows[4, pairs // 3 : pairs // 2]
    sums = products(rows, torch.rand(pairs, 256, dtype=torch.float64, generator=generator)).sum(dim=2).t()
    sums[pairs // 2 : pairs // 2 + 1, seed % CHANNELS] = torch.nan
    center = torch.randn(pairs, 3, dtype=torch.float64, generator=generator)
    update = solve(sums, center)
    with native_kernels(False):
        expected = solve(sums, center)
    assert torch.equal(update.usable, expected.usable)
    assert torch.equal(update.rotation, expected.rotation)
    assert torch.equal(update.translation, expected.translation)
