"""Rigid transforms compose, invert and move clouds without losing digits."""

from dataclasses import replace

import pytest
import torch
from closeness import close
from determinism import same_bits
from hypothesis import given
from hypothesis import strategies as st
from problems import random_transform
from refusals import refuses

import torchreg as tr
from torchreg.geometry.se3 import apply, apply_rotation, compose, inverse, rigid

EYE = torch.eye(4, dtype=torch.float64)


def cloud(rows, seed=0, *, origin=(0.0, 0.0, 0.0), dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    points, normals = torch.randn(2, rows, 3, dtype=torch.float64, generator=generator)
    return tr.Clouds(
        points=points.to(dtype),
        normals=torch.nn.functional.normalize(normals, dim=1).to(dtype),
        colors=torch.rand(rows, 3, dtype=torch.float64, generator=generator).to(dtype),
        origin=torch.tensor([origin], dtype=torch.float64),
        viewpoint=torch.randn(1, 3, dtype=torch.float64, generator=generator).to(dtype),
    )


@given(st.integers(0, 2**31))
def test_inverse(seed):
    T = random_transform(torch.Generator().manual_seed(seed))
    assert close(T @ inverse(T), EYE, atol=1e-13)
    assert close(inverse(T), torch.linalg.inv(T), atol=1e-12)


def test_compose_is_the_matrix_product_with_the_same_bits_in_any_batch():
    first, second = (
        torch.stack([random_transform(torch.Generator().manual_seed(seed)) for seed in range(start, start + 5)])
        for start in (0, 5)
    )
    together = compose(first, second)
    assert close(together, first @ second, atol=1e-13)
    for one, a, b in zip(together, first, second, strict=True):
        assert same_bits(one, compose(a, b))
    assert same_bits(compose(first, second[0])[3], compose(first[3], second[0]))  # broadcast


def test_inverse_of_a_batch():
    T = torch.stack([random_transform(torch.Generator().manual_seed(seed)) for seed in range(4)])
    for one, back in zip(T, inverse(T), strict=True):
        assert same_bits(inverse(one), back)


def test_apply_is_the_matrix_product():
    T = random_transform(torch.Generator().manual_seed(0))
    points = torch.randn(7, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    assert close(apply(T, points), points @ T[:3, :3].t() + T[:3, 3], atol=1e-14)
    assert same_bits(apply_rotation(T[:3, :3], points)[2:3], apply_rotation(T[:3, :3], points[2:3]))


def test_a_cloud_moves_with_normals_viewpoint_and_origin():
    T = random_transform(torch.Generator().manual_seed(3))
    before = cloud(9, origin=(10.0, -20.0, 30.0))
    after = tr.transform(before, T)
    R, t = T[:3, :3], T[:3, 3]
    world, moved = before.points + before.origin, after.points + after.origin
    assert close(moved, world @ R.t() + t, atol=1e-12)
    assert close(after.normals, before.normals @ R.t(), atol=1e-14)
    place = before.viewpoint + before.origin
    assert close(after.viewpoint + after.origin, place @ R.t() + t, atol=1e-12)
    assert torch.equal(after.colors, before.colors)


def test_points_of_utm_size_lose_nothing():
    T = random_transform(torch.Generator().manual_seed(4))
    near, far = cloud(9, dtype=torch.float32), cloud(9, dtype=torch.float32, origin=(5e5, 4.5e6, 300.0))
    assert torch.equal(tr.transform(near, T).points, tr.transform(far, T).points)
    expected = torch.tensor([5e5, 4.5e6, 300.0], dtype=torch.float64) @ T[:3, :3].t() + T[:3, 3]
    assert torch.allclose(tr.transform(far, T).origin[0], expected, atol=1e-8, rtol=0)


def test_points_are_rotated_in_float64_and_rounded_once():
    T = random_transform(torch.Generator().manual_seed(4))
    narrow = cloud(50, dtype=torch.float32)
    wide = tr.transform(narrow.to(dtype=torch.float64), T)
    for name in ("points", "normals", "viewpoint"):
        assert same_bits(getattr(tr.transform(narrow, T), name), getattr(wide, name).float())


def test_there_and_back():
    T = random_transform(torch.Generator().manual_seed(5))
    before = cloud(9, origin=(1.0, 2.0, 3.0))
    after = tr.transform(tr.transform(before, T), inverse(T))
    for name in ("points", "normals", "viewpoint", "origin"):
        assert close(getattr(after, name), getattr(before, name), atol=1e-12)


def test_a_batch_equals_the_loop_over_its_clouds():
    made = [cloud(rows, rows, origin=(float(rows), 0.0, 0.0)) for rows in (4, 0, 7)]
    T = torch.stack([random_transform(torch.Generator().manual_seed(seed)) for seed in range(3)])
    together = tr.transform(tr.Clouds.pack(made), T)
    alone = [tr.transform(one, T[b]) for b, one in enumerate(made)]
    assert same_bits(together, tr.Clouds.pack(alone))
    packed = tr.Clouds.pack(made)
    assert same_bits(tr.transform(packed, T[0]), tr.transform(packed, T[:1].expand(3, 4, 4)))


def test_a_cloud_of_points_alone_moves():
    moved = tr.transform(tr.Clouds(points=torch.zeros(2, 3)), EYE)
    assert moved.normals is None
    assert moved.viewpoint is None


def test_an_unknown_viewpoint_stays_unknown():
    one = tr.Clouds(points=torch.zeros(2, 3), viewpoint=torch.full((1, 3), float("nan")))
    assert torch.isnan(tr.transform(one, random_transform(torch.Generator())).viewpoint).all()


@pytest.mark.parametrize("assumed", [True, False])
def test_a_guess_stays_a_guess_and_a_known_viewpoint_known(assumed):
    moved = tr.transform(replace(cloud(4), viewpoint_assumed=torch.tensor([assumed])), EYE)
    assert moved.viewpoint_assumed.tolist() == [assumed]
    assert moved.viewpoint_known.tolist() == [not assumed]


def test_gradients_are_right():
    T = random_transform(torch.Generator().manual_seed(6))
    points = torch.randn(4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(7)).requires_grad_()
    rotation, translation = T[:3, :3].clone().requires_grad_(), T[:3, 3].clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda R, t, p: apply(inverse(rigid(R, t)), p), (rotation, translation, points))


def test_shapes_that_do_not_fit_are_refused():
    with refuses("rotation", "(..., 3, 3)", "(3, 4)"):
        rigid(torch.zeros(3, 4), torch.zeros(3))
    with refuses("translation", "(2, 3)", "(3,)"):
        rigid(torch.zeros(2, 3, 3), torch.zeros(3))
    with refuses("T", "(..., 4, 4)", "(3, 3)"):
        inverse(torch.eye(3))
    with refuses("T", "(4, 4)", "(1, 4, 4)"):
        apply(EYE[None], torch.zeros(2, 3))
    with refuses("points", "(P, 3)", "(3,)"):
        apply(EYE, torch.zeros(3))
    with refuses("T_to_from", "(1, 4, 4)", "(2, 4, 4)"):
        tr.transform(cloud(2), EYE.expand(2, 4, 4))


@pytest.mark.parametrize("shape", [(3, 3), (4,), (3, 4)])
def test_transforms_of_another_shape_are_refused(shape):
    with refuses("T_to_from", str(shape)):
        tr.transform(cloud(2), torch.zeros(shape, dtype=torch.float64))
