"""Residuals are plain distances; covariances cover the truth, follow the noise and know what nothing holds."""

import math
from itertools import pairwise

import pytest
import torch
from problems import turned
from scenes import FURNISHED, ROOM
from surfaces import CORRIDOR, FLOOR, REACH, faces, surfels_of_both, two_rooms, two_scans
from torch import Tensor

from torchreg.refinement.certainty import agreeing, certainty
from torchreg.refinement.pairing import Pairing, enter
from torchreg.refinement.refine import refine_on_surfels
from torchreg.refinement.settle import SurfelPairs
from torchreg.refinement.spread import CUT

EYE = torch.eye(4, dtype=torch.float64)
INSIDE_95 = 12.59  # the 95 % quantile of chi-squared with 6 degrees of freedom


def seen(pair, T=EYE, count=1000):
    """The state of one pair of clouds under T (4, 4), and its certainty."""
    pairs = SurfelPairs(*surfels_of_both(pair, count), Pairing([0], [0]))
    state = pairs.seen(*enter(pairs.frames, T[None]))
    return pairs, state, certainty(state, 0, float(pairs.spacing[0]))


@pytest.fixture(scope="module")
def room():
    return two_rooms(EYE, spacing=0.2)


@pytest.mark.parametrize("meters", [0.0, 0.02])
def test_residuals_are_distances_to_the_planes_of_the_nearest(room, meters):
    T = turned(0.2, (1.0, 1.0, 0.0), (0.0, meters, meters))
    pairs, state, known = seen(room, T)
    source, target = (each.cloud for each in surfels_of_both(room, 1000))
    moved = source.points @ T[:3, :3].T + T[:3, 3]
    apart, row = torch.cdist(moved, target.points).min(dim=1)
    distance = ((moved - target.points[row]) * target.normals[row]).sum(dim=1)
    facing = ((source.normals @ T[:3, :3].T) * target.normals[row]).sum(dim=1).abs()
    alike = (apart < 2 * float(pairs.spacing[0])) & (facing > 0.7)
    both = surfels_of_both(room, 1000)
    variance = both[0].variance + both[1].variance[row]
    whole = (1.4826 * distance[alike].abs().median()) ** 2
    deviation = (variance + (whole - variance[alike].median()).clamp(min=0)).sqrt()
    relative = distance.abs() / deviation
    kept = alike & (relative < CUT * 1.4826 * relative[alike].median())
    shown = distance[kept].abs()
    expected = torch.stack([shown.median(), shown.square().mean().sqrt(), shown.sort().values[int(0.95 * len(shown))]])
    torch.testing.assert_close(known.residuals, expected, rtol=1e-9, atol=0)
    assert float(known.overlap) == pytest.approx(float(kept.double().mean()))
    assert agreeing(state, 0) == int(kept.sum())
    center = moved[kept].mean(dim=0) - pairs.frames.target_center[0]
    torch.testing.assert_close(known.center, center, rtol=0, atol=1e-9)
    assert float(known.size) == pytest.approx(
        float((moved[kept] - moved[kept].mean(dim=0)).norm(dim=1).square().mean() ** 0.5)
    )


def test_half_an_overlap_is_told():
    half = two_scans(lambda g: faces(CORRIDOR, g), turned(0.0, translation=(10.0, 0.0, 0.0)))
    assert float(seen(half)[2].overlap) == pytest.approx(0.5, abs=0.05)
    assert float(seen(half, turned(0.0, translation=(10.0, 0.0, 0.0)))[2].overlap) > 0.9


def errors_of(T: Tensor, center: Tensor) -> Tensor:
    """The small turn about ``center`` and the shift (6,) by which T (4, 4) is off the identity; what takes it back."""
    back = torch.linalg.inv(T)
    turn = torch.stack([back[2, 1] - back[1, 2], back[0, 2] - back[2, 0], back[1, 0] - back[0, 1]]) / 2
    return torch.cat([turn, back[:3, :3] @ center + back[:3, 3] - center])


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.003, 0.01])
def test_the_truth_lies_within_the_covariance(noise):
    inside = []
    for seed in range(60):
        start = turned(0.2, (1.0, float(seed % 3), 2.0), (0.02, -0.02, 0.01))
        pair = two_rooms(EYE, noise=noise, spacing=0.15, seed=seed)
        result = refine_on_surfels(*surfels_of_both(pair, 1500), start[None], [REACH], [False])
        off = errors_of(result.T_target_source[0], result.center[0])
        inside.append(float(off @ torch.linalg.solve(result.covariance[0], off)) < INSIDE_95)
    assert 0.85 <= sum(inside) / len(inside) <= 1.0


@pytest.mark.slow
def test_deviations_are_of_the_size_of_the_errors():
    ratios = []
    for seed in range(60):
        pair = two_rooms(EYE, noise=0.005, spacing=0.15, seed=100 + seed)
        result = refine_on_surfels(*surfels_of_both(pair, 1500), EYE[None], [REACH], [False])
        off = errors_of(result.T_target_source[0], result.center[0])
        ratios.append(off / result.covariance[0].diagonal().sqrt())
    spread = torch.stack(ratios).square().mean(dim=0).sqrt()
    assert float(spread.max()) < 1.3
    assert float(spread.min()) > 0.2


def test_deviations_follow_the_noise():
    sizes = []
    for noise in (0.002, 0.004, 0.008):
        _, _, known = seen(two_rooms(EYE, noise=noise))
        sizes.append(float(torch.linalg.det(known.covariance[3:, 3:]) ** (1 / 6)))
    for small, large in pairwise(sizes):
        assert 1.4 < large / small < 2.8


def test_more_surface_is_known_better():
    few, many = (seen(two_rooms(EYE, spacing=spacing), count=5000)[2] for spacing in (0.3, 0.1))
    assert float(many.covariance.diagonal().sum()) < 0.5 * float(few.covariance.diagonal().sum())


def deviations_besides(known, free):
    """Of the motions but for the free ones, if these were known."""
    held = [place for place in range(6) if place not in free]
    information = torch.linalg.inv(known.covariance)[held][:, held]
    return torch.linalg.inv(information).diagonal().sqrt()


@pytest.mark.parametrize("axis", range(3))
def test_a_cube_holds_all_motions_and_a_corridor_all_but_one(axis):
    cube = (((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)),)
    _, _, known = seen(two_rooms(EYE, shapes=cube), count=3000)
    torch.testing.assert_close(
        known.held[3:], torch.full((3,), math.sqrt(1 / 3), dtype=torch.float64), atol=0.03, rtol=0
    )
    assert float(known.held[:3].min()) > 0.2
    order = [(place - axis) % 3 for place in range(3)]  # x of the corridor becomes this axis

    def corridor(g):
        return faces(CORRIDOR, g)[:, order]

    _, _, known = seen(two_scans(corridor, EYE), count=3000)
    assert float(known.held[3 + axis]) < 0.03
    assert float(known.covariance[3 + axis, 3 + axis].sqrt()) > 1.0
    assert float(deviations_besides(known, [3 + axis]).max()) < 0.002


def test_noise_in_normals_does_not_pass_for_a_wall():
    _, _, floor = seen(two_scans(lambda g: faces([FLOOR], g), EYE))
    free = [2, 3, 4]  # the turn within the floor and both shifts along it
    assert float(floor.covariance.diagonal()[free].sqrt().min()) > 0.1
    assert float(deviations_besides(floor, free).max()) < 0.002
    end = ((9.0, -1.5, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 2.5))  # one wall across is enough
    _, _, closed = seen(two_scans(lambda g: faces([*CORRIDOR, end], g), EYE), count=3000)
    assert float(closed.covariance.diagonal().sqrt().max()) < 0.002


def test_the_covariance_is_one():
    _, _, known = seen(two_rooms(EYE, shapes=[ROOM, *FURNISHED[1:]]))
    torch.testing.assert_close(known.covariance, known.covariance.T, rtol=1e-9, atol=1e-18)
    assert float(torch.linalg.eigvalsh(known.covariance)[0]) > 0


def test_too_few_surfels_have_no_figures():
    few = tuple(cloud.rows(torch.arange(8), torch.tensor([0, 8])) for cloud in two_rooms(EYE))
    sides = surfels_of_both(few)
    assert 0 < len(sides[0].cloud.points) < 12
    _, _, known = seen(few)
    for figure in (known.residuals, known.covariance, known.center, known.held, known.size):
        assert bool(figure.isnan().all())
    assert 0 <= float(known.overlap) <= 1
