"""A pose after a turn about a main direction of the place is found by few votes among many."""

import pytest
import torch
from determinism import assert_nothing_shows
from problems import random_transform, seeded, uniform

from torchreg.geometry.se3 import apply_rotation
from torchreg.registration import turned as module

THRESHOLD = 0.1
EYE = torch.eye(3, dtype=torch.float64)


def turned(rotation, normals, source, target, threshold, scored=None):
    """Scored on all matches unless other ones are named."""
    scored = torch.arange(len(source)) if scored is None else scored
    return module.turned(rotation, normals, source, target, threshold, scored)


def spread(size, count, seed=0):
    """Points (count, 3) in a cube of this size."""
    return size * uniform(count, 3, seed=seed).double()


def box_normals(axes, seed=0):
    """Of a box with the axes (3, 3) as rows, whose faces differ in area, with noise and a few edges."""
    generator = torch.Generator().manual_seed(seed)
    face = torch.multinomial(torch.tensor([0.5, 0.3, 0.2]), 600, replacement=True, generator=generator)
    noisy = axes[face] + 0.02 * torch.randn(600, 3, dtype=torch.float64, generator=generator)
    edges = axes[0] + axes[1] + 0.3 * axes[2] + 0.1 * torch.randn(60, 3, dtype=torch.float64, generator=generator)
    normals = torch.cat([noisy, edges])
    return normals / normals.norm(dim=1, keepdim=True)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("quarter", [1, 2])
def test_a_turned_pose_is_found_by_few_votes(seed, quarter):
    """100 of 3,000 matches agree with a pose that a turn about the most frequent normal takes the given one to."""
    axes, given = (random_transform(seeded(seed + k)).double()[:3, :3] for k in (0, 100))
    x, y, z = axes[0].tolist()
    cross = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64)
    turn = EYE + cross + cross @ cross if quarter == 1 else EYE + 2 * cross @ cross
    right, shift = turn @ given, torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
    source, target = spread(6, 3000, seed), spread(6, 3000, seed + 50) - 3
    target[:100] = apply_rotation(right, source[:100]) + shift + spread(0.02, 100, seed) - 0.01
    poses = turned(given, box_normals(axes), source, target, THRESHOLD)
    best = poses.rotation[0] @ right.t()
    assert float(best.trace()) > 1 + 2 * 0.9998  # within a degree
    moved = apply_rotation(poses.rotation[0], source[:100]) + poses.translation[0]
    assert float((moved - target[:100]).norm(dim=1).median()) < 0.5 * THRESHOLD
    assert int(poses.support[0]) > 90


def test_support_inliers_and_errors_are_those_of_the_poses():
    source, target = spread(3, 500), spread(3, 500, 1)
    poses = turned(EYE, box_normals(EYE), source, target, 0.5)
    assert len(poses.support) > 3
    assert poses.support.tolist() == sorted(poses.support.tolist(), reverse=True)
    for R, t, inliers, support, error in zip(*poses[:5], strict=True):
        square = (source @ R.t() + t - target).square().sum(dim=1)
        assert torch.equal(square < 0.25, inliers)
        assert int(support) == int(inliers.sum()) >= 5
        assert float(error) == pytest.approx(float(square[inliers].sum()))


def test_all_matches_vote_and_the_chosen_ones_are_scored():
    source, target, scored = spread(3, 500), spread(3, 500, 1), torch.arange(0, 500, 7)
    every, some = (
        turned(EYE, box_normals(EYE), source, target, 0.5),
        turned(EYE, box_normals(EYE), source, target, 0.5, scored),
    )
    assert torch.equal(every.rotation, some.rotation)
    assert torch.equal(every.translation, some.translation)
    assert torch.equal(every.inliers[:, scored], some.inliers)
    assert some.support.tolist() == some.inliers.sum(dim=1).tolist()


def test_no_votes_agree_where_matches_are_far_between():
    poses = turned(EYE, box_normals(EYE), spread(1000, 40), -spread(1000, 40, 1), THRESHOLD)
    assert len(poses.support) == 0


@pytest.mark.parametrize("normals", [torch.zeros(5, 3), torch.tensor([[0.0, 0.0, 1.0]]).repeat(5, 1)])
def test_places_without_three_directions_give_finite_poses(normals):
    poses = turned(EYE, normals, spread(3, 300), spread(3, 300, 1), 0.5)
    assert bool(torch.isfinite(poses.rotation).all())
    assert torch.allclose(poses.rotation @ poses.rotation.transpose(1, 2), EYE.expand(len(poses.rotation), 3, 3))


def test_neither_threads_nor_modes_change_a_bit():
    source, target = spread(3, 5000), spread(3, 5000, 1)
    assert_nothing_shows(lambda: turned(EYE, box_normals(EYE), source, target, 0.3)[:5])
