"""Settling: residuals grow smaller, what is noisy or moved counts less, and pairs that are done do not move."""

import pytest
import torch
from determinism import same_bits
from problems import turned
from scenes import FURNISHED
from surfaces import REACH, off_by, surfels_of_both, two_rooms

import torchreg as tr
from torchreg.geometry.se3 import inverse
from torchreg.refinement.pairing import Pairing, enter, leave
from torchreg.refinement.settle import SurfelPairs
from torchreg.refinement.surfels import Surfels

EYE = torch.eye(4, dtype=torch.float64)
NEAR = turned(0.3, (1.0, 2.0, 3.0), (0.03, -0.02, 0.02))


def pairs_of(*pairs):
    """Pairs of clouds, ready to settle, each with surfels of its own."""
    sides = [Surfels.pack(each) for each in zip(*(surfels_of_both(pair, 1000) for pair in pairs), strict=True)]
    return SurfelPairs(*sides, Pairing(range(len(pairs)), range(len(pairs))))


def settle(pairs, T, reach=REACH):
    """The state after settling from T (B, 4, 4), and the poses (B, 4, 4)."""
    count = len(T)
    state = pairs.settle(*enter(pairs.frames, T), torch.full((count,), reach, dtype=torch.float64))
    return state, leave(pairs.frames, state.rotation, state.translation)


@pytest.fixture(scope="module")
def rooms():
    """Three pairs of clouds, the second from the start where it belongs."""
    return [two_rooms(EYE, spacing=spacing, seed=seed) for seed, spacing in enumerate((0.2, 0.25, 0.15))]


def test_pairs_settle_together_as_alone(rooms):
    T = torch.stack([NEAR, EYE, inverse(NEAR)])
    state, poses = settle(pairs_of(*rooms), T)
    assert state.solvable == [True] * 3
    for b, pair in enumerate(rooms):
        own, pose = settle(pairs_of(pair), T[b : b + 1])
        assert same_bits(pose[0], poses[b].clone())
        assert own.updates == state.updates[b : b + 1]
        assert off_by(pose[0], EYE, pair[0].points) < 0.005


def test_settling_again_moves_next_to_nothing(rooms):
    pairs = pairs_of(*rooms)
    _, poses = settle(pairs, NEAR.expand(3, 4, 4))
    again, same = settle(pairs, poses)
    assert max(again.updates) < 30
    for b, pair in enumerate(rooms):
        assert off_by(same[b], poses[b], pair[0].points) < 1e-4


def test_seen_poses_stay_as_they_are(rooms):
    pairs = pairs_of(*rooms)
    R, t = enter(pairs.frames, NEAR.expand(3, 4, 4))
    state = pairs.seen(R, t)
    assert same_bits((state.rotation, state.translation), (R, t))
    settled, _ = settle(pairs, NEAR.expand(3, 4, 4))
    excess = state.spread.excess > settled.spread.excess  # what moved the poses apart is no noise
    assert bool(excess.all())


def test_displacement_is_about_the_root_mean_square_of_the_points(rooms):
    pairs = pairs_of(*rooms)
    one, other = (enter(pairs.frames, T.expand(3, 4, 4)) for T in (EYE, turned(0.0, translation=(0.3, 0.0, 0.4))))
    shift = pairs.displacement(range(3), *one, *other)
    torch.testing.assert_close(shift, torch.full((3,), 0.5, dtype=torch.float64))
    spun = turned(1.0, (0.0, 0.0, 1.0))
    R, t = enter(pairs.frames, EYE.expand(3, 4, 4))
    turn = pairs.displacement([1], (spun[:3, :3] @ R)[1:2], t[1:2], R[1:2], t[1:2])
    points = surfels_of_both(rooms[1], 1000)[0].cloud.points
    size = (points - points.mean(dim=0)).square().sum(dim=1).mean().sqrt()
    assert float(turn) == pytest.approx(float(torch.deg2rad(torch.tensor(1.0)) * size), rel=1e-3)


def test_a_noisy_part_counts_for_less(rooms):
    source, target = rooms[2]
    generator = torch.Generator().manual_seed(5)
    noise = 0.04 * torch.randn(source.points.shape, generator=generator, dtype=torch.float64)
    half = (source.points[:, :1] > 0).double()
    noisy = tr.Clouds(points=source.points + half * noise)
    _, clean = settle(pairs_of((source, target)), NEAR[None])
    _, pose = settle(pairs_of((noisy, target)), NEAR[None])
    assert off_by(clean[0], EYE, source.points) < 0.003
    assert off_by(pose[0], EYE, source.points) < 0.01  # a quarter of that noise


def test_furniture_that_moved_has_no_weight(rooms):
    moved = [*FURNISHED[:3], ((0.3, 1.38, 1.1), (1.4, 0.4, 0.3))]
    after = two_rooms(EYE, shapes=moved, spacing=0.15, seed=2)[1]
    _, before = settle(pairs_of(rooms[2]), NEAR[None])
    _, pose = settle(pairs_of((rooms[2][0], after)), NEAR[None])
    assert off_by(pose[0], before[0], rooms[2][0].points) < 0.004  # of 12 cm


def test_exact_planes_that_leave_a_motion_open_are_told():
    grid = torch.cartesian_prod(*[torch.arange(30, dtype=torch.float64) / 10] * 2)
    floor = tr.Clouds(points=torch.cat([grid, torch.zeros(len(grid), 1)], dim=1))
    state, pose = settle(pairs_of((floor, floor)), EYE[None])
    assert state.solvable == [False]
    assert torch.equal(pose[0], EYE)
