"""Draws follow from the seed and the pair alone; the closed form of a triangle against Kabsch; whether samples fit."""

import pytest
import torch
from closeness import close
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_transform

import torchreg as tr
from torchreg.solvers.ransac.samples import FIRST_ROUND, sample_fits, sample_rounds, solve_samples, spans_plane

CPU = torch.device("cpu")


def samples(count, size=3, seed=0, noise=0.0, dtype=torch.float64):
    """Samples (3, size, count) of both sides and the true transform."""
    generator = torch.Generator().manual_seed(seed)
    source = torch.randn(3, size, count, dtype=torch.float64, generator=generator)
    T = random_transform(generator)
    target = torch.einsum("ij,jsh->ish", T[:3, :3], source) + T[:3, 3, None, None]
    target = target + noise * torch.randn(3, size, count, dtype=torch.float64, generator=generator)
    return source.to(dtype), target.to(dtype), T


def error(source, target, rotation, translation):
    """(H,) sums of squared distances."""
    moved = torch.einsum("ijh,jsh->ish", rotation, source) + translation[:, None]
    return (moved - target).square().sum(dim=(0, 1))


def assert_rotations(rotation, tolerance=1e-12):
    R = rotation.permute(2, 0, 1)
    identity = torch.eye(3, dtype=R.dtype).expand_as(R)
    assert close(R.transpose(1, 2) @ R, identity, atol=tolerance)
    assert close(torch.linalg.det(R), torch.ones((), dtype=R.dtype), atol=tolerance)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.floats(0, 0.5))
def test_the_triangle_is_solved_as_kabsch_does(seed, noise):
    source, target, _ = samples(20, seed=seed, noise=noise)
    rotation, translation = solve_samples(source, target)
    T = tr.kabsch(source.permute(2, 1, 0), target.permute(2, 1, 0))
    assert_rotations(rotation)
    found = error(source, target, rotation, translation)
    best = error(source, target, T[:, :3, :3].permute(1, 2, 0), T[:, :3, 3].t())
    assert (found <= best * (1 + 1e-6) + 1e-12).all()
    apart = (rotation.permute(2, 0, 1) - T[:, :3, :3]).abs().amax(dim=(1, 2))
    assert (apart < 1e-4).float().mean() >= 0.9  # thin triangles leave the rotation nearly open


@pytest.mark.parametrize("size", [3, 4, 6])
def test_a_clean_sample_gives_the_truth(size):
    source, target, T = samples(100, size)
    rotation, translation = solve_samples(source, target)
    assert_rotations(rotation)
    assert close(rotation.permute(2, 0, 1), T[:3, :3].expand(100, 3, 3), atol=1e-8)
    assert close(translation, T[:3, 3:].expand(3, 100), atol=1e-8)


def test_float32_is_close():
    source, target, T = samples(100, dtype=torch.float32)
    rotation, translation = solve_samples(source, target)
    assert rotation.dtype == translation.dtype == torch.float32
    apart = (rotation.double().permute(2, 0, 1) - T[:3, :3]).abs().amax(dim=(1, 2))
    assert (apart < 1e-4).float().mean() > 0.95


@pytest.mark.parametrize("size", [3, 4])
def test_a_mirrored_sample_never_gives_a_reflection(size):
    source, target, _ = samples(100, size)
    target[2] *= -1
    assert_rotations(solve_samples(source, target)[0])


def test_degenerate_samples_stay_finite():
    line = torch.arange(3.0, dtype=torch.float64)[None, :, None].expand(3, 3, 1)
    place = torch.ones(3, 3, 1, dtype=torch.float64)
    for source, target in ((line, line), (place, place), (line, place), (place, line)):
        rotation, translation = solve_samples(source.contiguous(), target.contiguous())
        assert torch.isfinite(rotation).all()
        assert torch.isfinite(translation).all()


def test_a_sample_has_its_bits_whatever_stands_beside_it():
    source, target, _ = samples(1001, noise=0.1, dtype=torch.float32)
    rotation, translation = solve_samples(source, target)
    for cut in (slice(0, 1), slice(3, 20), slice(500, 1001)):
        alone = solve_samples(source[..., cut].contiguous(), target[..., cut].contiguous())
        assert same_bits(alone[0], rotation[..., cut].contiguous())
        assert same_bits(alone[1], translation[..., cut].contiguous())


def test_a_sample_fits_when_every_point_does():
    source = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]).t()[..., None].expand(3, 3, 4)
    target = source.clone()
    target[0, 0, 1] += 0.09  # within the threshold
    target[2, 1, 2] += 0.11  # one point beyond it
    target[1, 2, 3] += 0.1  # at it
    eye = torch.eye(3)[..., None].expand(3, 3, 4)
    assert sample_fits(source, target, eye, torch.zeros(3, 4), 0.1).tolist() == [True, True, False, False]


@pytest.mark.parametrize(("degrees", "spans"), [(0.0, False), (2.0, False), (4.0, True), (90.0, True), (178.0, False)])
def test_points_nearly_on_a_line_leave_the_rotation_open(degrees, spans):
    angle = torch.tensor(degrees).deg2rad()
    points = torch.tensor([[0.0, 0, 0], [2, 0, 0], [float(angle.cos()), float(angle.sin()), 0]]).t()[..., None]
    assert spans_plane(points).tolist() == [spans]
    assert spans_plane(1e3 * points + 7).tolist() == [spans]


def test_coincident_points_span_nothing():
    assert spans_plane(torch.ones(3, 3, 2)).tolist() == [False, False]


@given(st.integers(1, 50), st.integers(3, 5), st.integers(1, 5000), st.integers(0, 2**60))
def test_exactly_so_many_samples_in_range(count, size, total, seed):
    samples = torch.cat(list(sample_rounds(count, size, total, seed, CPU)))
    assert samples.shape == (total, size)
    assert samples.min() >= 0
    assert samples.max() < count


def test_a_smaller_total_draws_the_same_first_rounds():
    rounds = list(sample_rounds(100, 3, 200_000, 7, CPU))
    few = torch.cat(list(sample_rounds(100, 3, 3 * FIRST_ROUND, 7, CPU)))
    assert torch.equal(torch.cat(rounds[:2]), few)
    assert not torch.equal(rounds[1][:FIRST_ROUND], rounds[0])
    assert [len(drawn) for drawn in rounds[:6]] == [1 << 12, 1 << 13, 1 << 14, 1 << 15, 1 << 15, 1 << 15]


def test_every_correspondence_is_as_likely():
    samples = torch.cat(list(sample_rounds(10, 3, 20_000, 1, CPU)))
    counts = torch.bincount(samples.flatten(), minlength=10)
    assert (counts - 6000).abs().max() < 6 * 6000**0.5


def test_the_global_generator_is_left_alone():
    before = torch.get_rng_state()
    list(sample_rounds(5, 3, 10, 2, CPU))
    assert torch.equal(torch.get_rng_state(), before)
