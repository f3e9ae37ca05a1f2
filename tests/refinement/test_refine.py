"""Poses refined on surfels: to a part of the noise, no farther than the surfaces hold, and of each pair alone."""

from dataclasses import replace

import pytest
import torch
from closeness import assert_rigid
from determinism import THREADS, same_bits, threads
from problems import random_points, turned
from scenes import FURNISHED
from surfaces import CORRIDOR, FLOOR, NOISE, REACH, faces, off_by, surfels_of_both, two_rooms, two_scans

import torchreg as tr
from torchreg.geometry.se3 import inverse
from torchreg.refinement.refine import FARTHER, FEW, Refined, refine_on_surfels, residuals_under
from torchreg.refinement.surfels import Surfels, surfels_of

T_TRUE = turned(40.0, (1.0, 2.0, 3.0), (1.0, -2.0, 0.5))
NEAR = turned(0.3, (1.0, 2.0, 3.0), (0.03, -0.02, 0.02))
EYE = torch.eye(4, dtype=torch.float64)


def refine(pair, T, reach=REACH, count=3000):
    """One pair of clouds from T (4, 4)."""
    return refine_on_surfels(*surfels_of_both(pair, count), T[None], [reach], [False])


def deviations(result):
    """Of turns and shifts, (6,)."""
    return result.covariance[0].diagonal().sqrt()


@pytest.fixture(scope="module")
def room():
    return two_rooms(T_TRUE)


@pytest.fixture(scope="module")
def refined(room):
    return refine(room, NEAR @ T_TRUE)


@pytest.mark.parametrize("noise", [0.002, 0.005, 0.01])
@pytest.mark.parametrize("count", [1000, 20_000])
def test_a_room_comes_back_within_a_part_of_the_noise(noise, count):
    pair = two_rooms(T_TRUE, noise=noise)
    result = refine(pair, NEAR @ T_TRUE, count=count)
    assert result.reason == ("",)
    assert off_by(result.T_target_source[0], T_TRUE, pair[0].points) < 0.5 * noise
    assert float(result.residuals[0, 0]) < noise
    assert bool((result.residuals[0].diff() > 0).all())
    assert_rigid(result.T_target_source)


@pytest.mark.parametrize("turn", [0.0, 33.0])
def test_walls_along_the_axes_or_not_are_met_in_dense_scans_too(turn):
    # where the grid of the surfels cuts the walls lengthwise
    T = turned(turn, (1.0, 2.0, 3.0))
    pair = two_rooms(T, noise=0.01, spacing=0.03)
    assert off_by(refine(pair, NEAR @ T).T_target_source[0], T, pair[0].points) < 0.001


def test_where_it_starts_within_reach_does_not_matter(room, refined):
    for start in (T_TRUE, turned(-0.4, (0.0, 1.0, 1.0), (-0.05, 0.0, 0.03)) @ T_TRUE):
        other = refine(room, start)
        assert off_by(other.T_target_source[0], refined.T_target_source[0], room[0].points) < 0.02 * NOISE


def test_moving_both_clouds_moves_the_pose(room, refined):
    A = turned(110.0, (1.0, -1.0, 0.2), (4.0, 5.0, -1.0))
    B = turned(-70.0, (0.1, 0.4, 1.0), (-3.0, 2.0, 8.0))
    moved = (tr.transform(room[0], A), tr.transform(room[1], B))
    result = refine(moved, B @ NEAR @ T_TRUE @ inverse(A))
    back = inverse(B) @ result.T_target_source[0] @ A
    assert off_by(back, T_TRUE, room[0].points) < 0.5 * NOISE  # on surfels of other cubes
    assert off_by(back, refined.T_target_source[0], room[0].points) < 0.5 * NOISE


def test_surfels_moved_themselves_move_the_pose_but_for_rounding(room, refined):
    A, B = turned(110.0, (1.0, -1.0, 0.2), (4.0, 5.0, -1.0)), turned(-70.0, (0.1, 0.4, 1.0), (-3.0, 2.0, 8.0))
    sides = [
        Surfels(tr.transform(one.cloud, T), one.variance, one.spacing)
        for one, T in zip(surfels_of_both(room), (A, B), strict=True)
    ]
    start = B @ NEAR @ T_TRUE @ inverse(A)
    result = refine_on_surfels(*sides, start[None], [REACH], [False])
    back = inverse(B) @ result.T_target_source[0] @ A
    assert off_by(back, refined.T_target_source[0], room[0].points) < 2e-5  # covariances are of cells along the axes
    torch.testing.assert_close(result.residuals, refined.residuals, rtol=1e-2, atol=0)
    center = B[:3, :3] @ refined.center[0] + B[:3, 3]
    torch.testing.assert_close(result.center[0], center, rtol=0, atol=1e-4)
    sizes = [torch.linalg.det(each.covariance[0, 3:, 3:]) ** (1 / 6) for each in (result, refined)]
    assert 0.5 < float(sizes[0] / sizes[1]) < 2


def test_origins_of_utm_size_lose_nothing(room, refined):
    utm = torch.tensor([[512_345.25, 5_412_345.5, 431.125]], dtype=torch.float64)
    sides = [replace(cloud, origin=cloud.origin + utm) for cloud in room]
    shift = EYE.clone()
    shift[:3, 3] = utm[0]
    result = refine(sides, shift @ NEAR @ T_TRUE @ inverse(shift))
    back = inverse(shift) @ result.T_target_source[0] @ shift
    assert off_by(back, refined.T_target_source[0], room[0].points) < 1e-6
    torch.testing.assert_close(result.center - utm, refined.center, rtol=0, atol=1e-5)


def test_swapped_sides_give_about_the_inverse(room, refined):
    result = refine(room[::-1], inverse(NEAR @ T_TRUE))
    assert off_by(inverse(result.T_target_source[0]), refined.T_target_source[0], room[0].points) < 0.3 * NOISE


def test_what_moved_between_the_scans_does_not_pull(refined, room):
    moved = list(FURNISHED)
    moved[1] = ((-2.0, 1.24, 0.42), (1.2, 0.8, 0.8))
    moved[2] = ((1.54, -0.96, 0.9), (0.6, 1.0, 1.8))
    after = two_rooms(EYE, shapes=moved)[1]
    result = refine((room[0], after), NEAR @ T_TRUE)
    assert off_by(result.T_target_source[0], T_TRUE, room[0].points) < 0.5 * NOISE


@pytest.mark.parametrize("seed", range(3))
def test_along_a_corridor_the_pose_stays_and_is_refined_across(seed):
    pair = two_scans(lambda g: faces(CORRIDOR, g), EYE, seed=seed)
    result = refine(pair, NEAR)
    off, before = (T @ torch.cat([result.center[0], torch.ones(1)]).double() for T in (result.T_target_source[0], NEAR))
    off, before = off[:3] - result.center[0], before[:3] - result.center[0]
    assert result.reason == ("",)
    assert abs(float(off[0] - before[0])) < 0.01 * REACH
    assert float(off[1:].abs().max()) < 0.2 * NOISE
    assert tr.metrics.rre(result.T_target_source[0], EYE) < 0.05
    assert result.held[0, 3] < 0.03
    assert result.held[0, 4:].min() > 0.4
    assert deviations(result)[3] > 0.1 * REACH
    assert deviations(result)[4:].max() < NOISE


@pytest.mark.parametrize("seed", range(3))
def test_a_floor_alone_is_refined_across_itself_only(seed):
    pair = two_scans(lambda g: faces([FLOOR], g), EYE, seed=seed)
    result = refine(pair, NEAR)
    center = torch.cat([result.center[0], torch.ones(1, dtype=torch.float64)])
    left, before = (torch.linalg.inv(NEAR) @ result.T_target_source[0] @ center)[:3], center[:3]
    assert float((left - before)[:2].abs().max()) < 0.05 * REACH  # where it was along the floor
    assert abs(float((result.T_target_source[0] @ center)[2] - center[2])) < 0.2 * NOISE
    assert result.held[0, [2, 3, 4]].max() < 0.05
    assert deviations(result)[3:5].min() > 0.1 * REACH


def test_a_start_out_of_reach_stays_with_a_reason(room):
    start = turned(0.0, translation=(0.3, 0.3, 0.3)) @ T_TRUE
    result = refine(room, start, reach=0.2, count=300)  # whose surfels see farther than that
    assert result.reason == (FARTHER,)
    assert same_bits(result.T_target_source[0], start)
    assert all(bool(figure.isnan().all()) for figure in result[2:])


@pytest.mark.parametrize("empty", [0, 1])
def test_without_surfels_a_pose_stays_with_a_reason(room, empty):
    sides = list(surfels_of_both(room, 300))
    sides[empty] = surfels_of(tr.Clouds(points=torch.zeros(0, 3, dtype=torch.float64)), 300)
    result = refine_on_surfels(*sides, T_TRUE[None], [REACH], [False])
    assert result.reason == (FEW,)
    assert torch.equal(result.T_target_source[0], T_TRUE)
    assert bool(residuals_under(*sides, T_TRUE[None], [False]).isnan().all())


def test_clouds_apart_stay_with_a_reason(room):
    start = turned(0.0, translation=(100.0, 0.0, 0.0)) @ T_TRUE
    result = refine(room, start)
    assert result.reason[0]
    assert same_bits(result.T_target_source[0], start)
    assert bool(result.residuals.isnan().all())
    assert bool(residuals_under(*surfels_of_both(room), start[None], [False]).isnan().all())


@pytest.fixture(scope="module")
def several():
    """Five pairs of surfels: rooms of three sizes, one pair to skip and one without surfels; starts and flags."""
    pairs = [two_rooms(T_TRUE, spacing=spacing, seed=seed) for seed, spacing in enumerate((0.15, 0.25, 0.2))]
    nothing = tr.Clouds(points=random_points(3).double())
    pairs = [pairs[0], (nothing, nothing), *pairs[1:], pairs[0]]
    sides = [Surfels.pack(each) for each in zip(*(surfels_of_both(pair, 1000) for pair in pairs), strict=True)]
    return *sides, (NEAR @ T_TRUE).expand(5, 4, 4).contiguous(), [REACH] * 5, [False] * 4 + [True]


def pair_of(result, b):
    return Refined(*(field[b : b + 1] for field in result))


@pytest.mark.parametrize("number", THREADS)
def test_a_pair_has_the_same_bits_alone_in_a_batch_and_with_any_number_of_threads(several, number):
    source, target, T, reach, skipped = several
    with threads(number):
        result = refine_on_surfels(*several)
        assert torch.get_num_threads() == number
    assert [bool(reason) for reason in result.reason] == [False, True, False, False, False]
    for b in range(5):
        sides = source.unpack()[b], target.unpack()[b]
        alone = refine_on_surfels(*sides, T[b : b + 1], reach[b : b + 1], skipped[b : b + 1])
        assert same_bits(tuple(alone), tuple(pair_of(result, b)))


def test_skipped_pairs_stay_bit_for_bit(several):
    source, target, T, reach, skipped = several
    result = refine_on_surfels(*several)
    assert same_bits(result.T_target_source[4], T[4])
    assert (result.reason[4], bool(result.residuals[4].isnan().all())) == ("", True)
    none = refine_on_surfels(source, target, T, reach, [True] * 5)
    assert same_bits(none.T_target_source, T)
    assert none.reason == ("",) * 5
    assert bool(residuals_under(source, target, T, skipped)[4].isnan().all())


def test_residuals_at_a_pose_are_those_of_the_refined_one_there(room, refined):
    sides = surfels_of_both(room)
    under = residuals_under(*sides, refined.T_target_source, [False])
    torch.testing.assert_close(under, refined.residuals, rtol=0.02, atol=0)
    off = residuals_under(*sides, (NEAR @ T_TRUE)[None], [False])
    assert float(off[0, 0]) > 5 * float(under[0, 0])
