"""The best rotation is that of Kabsch, of any covariance, and no worse where several are best."""

import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from hypothesis import given
from hypothesis import strategies as st
from problems import random_rotation

import torchreg as tr
from torchreg.geometry.best_rotation import best_rotation, best_translation
from torchreg.native import native_kernels

CASES = ("any", "mirrored", "planar", "line", "point", "equal", "rotation")


def covariances(case, count=40, seed=0):
    """(3, 3, H) of a kind."""
    generator = torch.Generator().manual_seed(seed)
    turned = torch.stack([random_rotation(generator) for _ in range(2 * count)]).view(2, count, 3, 3)
    spread = torch.rand(count, 3, dtype=torch.float64, generator=generator) + 0.1
    if case == "mirrored":
        spread[:, 2] *= -1
    elif case in ("planar", "line", "point"):
        spread[:, CASES.index("point") - CASES.index(case) :] = 0
    elif case in ("equal", "rotation"):
        spread[:] = 1.0
    made = (turned[0] * spread[:, None]) @ turned[1].transpose(1, 2)
    return (made.float().double() if case == "rotation" else made).permute(1, 2, 0).contiguous()


def gain(rotation, covariance):
    """tr(R C), (H,)."""
    return (rotation * covariance.transpose(0, 1)).sum(dim=(0, 1))


def by_kabsch(covariance):
    """The greatest tr(R C) of rotations, from singular values."""
    C = covariance.permute(2, 0, 1)
    singular = torch.linalg.svdvals(C)
    return singular[:, 0] + singular[:, 1] + torch.det(C).sign() * singular[:, 2]


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_no_rotation_gains_more(case, compiled):
    covariance = covariances(case)
    with native_kernels(compiled):
        rotation = best_rotation(covariance)
    R = rotation.permute(2, 0, 1)
    assert close(R @ R.transpose(1, 2), torch.eye(3, dtype=torch.float64).expand_as(R), atol=1e-14)
    assert close(torch.det(R), torch.ones(len(R), dtype=torch.float64), atol=1e-14)
    assert close(gain(rotation, covariance), by_kabsch(covariance), atol=1e-12)


@given(st.integers(0, 2**31), st.integers(4, 30))
def test_points_are_turned_as_kabsch_turns_them(seed, count):
    generator = torch.Generator().manual_seed(seed)
    source, target = torch.randn(2, count, 3, dtype=torch.float64, generator=generator)
    p, q = (side - side.mean(dim=0) for side in (source, target))
    rotation = best_rotation((p.t() @ q)[..., None])
    translation = best_translation(rotation, source.mean(dim=0)[:, None], target.mean(dim=0)[:, None])
    expected = tr.kabsch(source, target)
    assert close(
        gain(rotation, (p.t() @ q)[..., None]), gain(expected[:3, :3, None], (p.t() @ q)[..., None]), atol=1e-9
    )
    moved = rotation[..., 0] @ source.mean(dim=0) + translation[:, 0]
    assert close(moved, target.mean(dim=0), atol=1e-12)


def test_the_nearest_rotation_is_the_rotation():
    matrix = covariances("rotation")
    assert close(best_rotation(matrix.transpose(0, 1)), matrix, atol=1e-6)
    exact = covariances("equal")
    assert close(best_rotation(exact.transpose(0, 1)), exact, atol=1e-14)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_the_scale_does_not_matter(scale):
    covariance = covariances("any")
    assert close(best_rotation(scale * covariance), best_rotation(covariance), atol=1e-12)


def test_nothing_gives_the_identity():
    identity = torch.eye(3, dtype=torch.float64)[..., None]
    assert torch.equal(best_rotation(torch.zeros(3, 3, 1, dtype=torch.float64)), identity)


def test_a_matrix_has_its_bits_whatever_stands_beside_it_compiled_or_not():
    covariance = torch.cat([covariances(case, 50) for case in CASES], dim=-1)
    together = best_rotation(covariance)
    for compiled in (False, True):
        for number in THREADS:
            with native_kernels(compiled), threads(number):
                assert same_bits(best_rotation(covariance), together)
                assert same_bits(best_rotation(covariance[..., 7:8]), together[..., 7:8])
