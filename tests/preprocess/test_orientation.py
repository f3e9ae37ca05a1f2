"""Normals along surfaces: lines are kept, neighbors agree, and motion and batch do not matter."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from determinism import THREADS, same_bits, threads
from problems import random_transform
from scenes import FURNISHED, SPACING, boxes

import torchreg as tr
from torchreg.preprocess.orientation import orient_along_surfaces, orient_like


def sphere(count: int = 600, seed: int = 0) -> tr.Clouds:
    points = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))
    return tr.Clouds(points=torch.nn.functional.normalize(points, dim=1) + torch.tensor([4.0, 0.0, 0.0]))


def with_random_signs(cloud: tr.Clouds, seed: int = 1) -> tuple[tr.Clouds, tr.types.Neighborhoods]:
    near = tr.neighbors(cloud, 0.5, 20)
    cloud = tr.estimate_normals(cloud, near)
    signs = torch.randint(0, 2, (len(cloud.points), 1), generator=torch.Generator().manual_seed(seed)) * 2.0 - 1
    return replace(cloud, normals=cloud.normals * signs), near


def test_a_closed_surface_faces_outwards_whatever_the_signs_were():
    for seed in range(3):
        cloud, near = with_random_signs(sphere(), seed)
        normals = orient_along_surfaces(cloud, near).normals
        outwards = (normals * (cloud.points - torch.tensor([4.0, 0.0, 0.0]))).sum(dim=1)
        assert bool((outwards > 0).all())


def test_lines_of_normals_are_kept():
    cloud, near = with_random_signs(sphere())
    normals = orient_along_surfaces(cloud, near).normals
    assert torch.equal(normals.abs(), cloud.normals.abs())


def test_neighbors_agree_in_a_furnished_room():
    points = boxes(FURNISHED, torch.Generator().manual_seed(0))
    cloud, near = with_random_signs(tr.voxel_downsample(tr.Clouds(points=points), SPACING))
    normals = orient_along_surfaces(cloud, near).normals

    def agreeing(of):
        cosine = (of[:, None] * of[near.index[:, 1:6]]).sum(dim=2)
        return float(((cosine > 0) | ~near.valid[:, 1:6]).double().mean())

    assert agreeing(cloud.normals) < 0.6
    assert agreeing(normals) > 0.97


def test_signs_move_with_the_cloud():
    cloud, near = with_random_signs(sphere())
    T = random_transform(torch.Generator().manual_seed(2)).double()
    moved = tr.transform(cloud, T)
    still = tr.transform(orient_along_surfaces(cloud, near), T)
    assert torch.allclose(orient_along_surfaces(moved, near).normals, still.normals, atol=1e-6)


def test_a_batch_equals_the_loop_over_its_clouds():
    clouds = [sphere(300, 0), sphere(50, 1), tr.Clouds(points=torch.zeros(0, 3)), sphere(2, 2)]
    batch = tr.Clouds.pack(clouds)
    packed, near = with_random_signs(batch)
    alone = [
        orient_along_surfaces(cloud, near.of_rows(begin, end)).normals
        for cloud, begin, end in zip(packed.unpack(), packed.offsets[:-1], packed.offsets[1:], strict=True)
    ]
    assert same_bits(orient_along_surfaces(packed, near).normals, torch.cat(alone))


@pytest.mark.parametrize("number", THREADS)
def test_the_number_of_threads_does_not_show(number):
    cloud, near = with_random_signs(sphere(3000))
    expected = orient_along_surfaces(cloud, near).normals
    with threads(number):
        assert same_bits(orient_along_surfaces(cloud, near).normals, expected)


def test_normals_are_needed():
    cloud = sphere()
    with pytest.raises(ValueError, match="normals"):
        orient_along_surfaces(cloud, tr.neighbors(cloud, 0.5, 20))


def test_normals_take_the_sides_of_hints_that_agree():
    cloud, near = with_random_signs(sphere())
    inwards = torch.tensor([4.0, 0.0, 0.0]) - cloud.points
    assert bool(((orient_like(cloud, inwards, near).normals * inwards).sum(dim=1) > 0).all())


def test_hints_left_to_chance_are_ignored():
    cloud, near = with_random_signs(sphere())
    other = with_random_signs(sphere(), seed=7)[0].normals
    assert torch.equal(orient_like(cloud, other, near).normals, cloud.normals)
    assert torch.equal(orient_like(cloud, torch.zeros_like(other), near).normals, cloud.normals)
