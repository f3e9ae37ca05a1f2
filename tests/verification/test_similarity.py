"""Mirrored and scaled matches are found with their figures; what a rigid pose explains is never taken for either."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from problems import columns, correspondence_problem, numbers, room_pair

import torchreg as tr
from torchreg.geometry.se3 import apply_rotation
from torchreg.verification.agreement import MatchEndpoints, agreement, match_cells
from torchreg.verification.impostors import impostor, mirrored_failure, scaled_failure
from torchreg.verification.similarity import Mirrored, RigidFit, Scaled, impossible_as_rigid

THRESHOLD = 0.1
FLIP = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)


def endpoints(problem):
    source, target = columns(problem, torch.float64)
    return source.t(), target.t()


def fit_of(T, source, target):
    """What supports the rigid transform T (4, 4)."""
    R, t = T[:3, :3], T[:3, 3]
    shown = agreement(match_cells(MatchEndpoints(source, target), THRESHOLD), R[None], t[None])
    inliers = (apply_rotation(R, source) + t - target).square().sum(dim=1) < THRESHOLD**2
    return RigidFit(inliers, float(shown.surprise[0]))


def first(count, total, surprise=0.0):
    """A fit that the first so many matches support."""
    return RigidFit(torch.arange(total) < count, surprise)


def found_in(source, target):
    """The finding where no rigid pose has any support."""
    return impossible_as_rigid(source, target, THRESHOLD, first(0, len(source)))


@pytest.mark.parametrize("factor", [0.5, 0.7, 0.85, 0.9, 1.1, 1.2, 1.4])
@pytest.mark.parametrize("outliers", [0.1, 0.7])
@pytest.mark.parametrize("seed", range(3))
def test_the_factor_is_named_within_its_uncertainty(factor, outliers, seed):
    problem = correspondence_problem(1200, outliers, noise=0.02, place="room", seed=seed)
    source, target = endpoints(problem)
    found = found_in(source, factor * target)
    assert isinstance(found, Scaled)
    assert abs(found.factor - factor) < 3.5 * found.deviation
    assert found.deviation < 0.003
    assert found.support > 0.9 * int(problem.is_inlier.sum())


def test_the_stated_uncertainty_is_that_of_repeated_measurements():
    """Of independent matches; those of one place count as one, so that it may be too large, and never too small."""
    errors = []
    for seed in range(30):
        source, target = endpoints(correspondence_problem(500, 0.2, noise=0.02, seed=seed))
        found = found_in(source, 1.2 * target)
        errors.append((found.factor - 1.2) / found.deviation)
    spread = float(torch.tensor(errors).square().mean().sqrt())
    assert 0.4 < spread < 1.4


@pytest.mark.parametrize("seed", range(3))
def test_swapped_clouds_have_the_inverse_factor(seed):
    source, target = endpoints(correspondence_problem(800, 0.5, seed=seed))
    one = found_in(source, 1.2 * target)
    other = found_in(1.2 * target, source)
    assert one.factor * other.factor == pytest.approx(1.0, abs=3 * (one.deviation + other.deviation))


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.6])
def test_a_reflection_is_found_whatever_its_plane(outliers):
    problem = correspondence_problem(900, outliers, place="room")
    source, target = endpoints(problem)
    found = found_in(source * FLIP + 3.0, target)
    assert isinstance(found, Mirrored)
    assert found.support > 0.95 * int(problem.is_inlier.sum())


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0])
@pytest.mark.parametrize("place", ["cube", "room"])
@pytest.mark.parametrize("rival", [0.0, 0.2])
def test_rigid_problems_are_no_impostors(outliers, place, rival):
    problem = correspondence_problem(1000, outliers, place=place, rival=min(rival, outliers))
    source, target = endpoints(problem)
    assert impossible_as_rigid(source, target, THRESHOLD, fit_of(problem.T_target_source[0], source, target)) is None


def test_unrelated_matches_are_no_impostors_even_without_any_pose():
    for seed in range(10):
        source, target = endpoints(correspondence_problem(400, 1.0, place="room", seed=seed))
        assert impossible_as_rigid(source, target, THRESHOLD, first(0, len(source))) is None


@pytest.mark.parametrize("share", [0.3, 0.5, 0.6])
def test_a_scene_that_equals_its_mirror_image_has_a_rigid_truth(share):
    """Of its matches, ``share`` join the right places and as many the mirrored ones, as features may do."""
    count = 1000
    source = 4 * torch.rand(count, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    problem = correspondence_problem(count, 0.0, noise=0.0)
    T = problem.T_target_source[0]
    places = source.clone()
    places[int(share * count) :, 0] *= -1  # mirrored through the scene's own plane x = 0
    target = apply_rotation(T[:3, :3], places) + T[:3, 3] + 0.01 * numbers(count, 3)
    assert impossible_as_rigid(source, target, THRESHOLD, fit_of(problem.T_target_source[0], source, target)) is None


def test_a_facade_equals_its_mirror_image():
    """All points on a plane: a reflection explains all matches, and so does a rigid pose."""
    problem = correspondence_problem(800, 0.4, noise=0.01)
    source, target = endpoints(problem)
    flat = source * torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)
    T = problem.T_target_source[0]
    right = (apply_rotation(T[:3, :3], source) + T[:3, 3] - target).square().sum(dim=1) < THRESHOLD**2
    target = torch.where(right[:, None], apply_rotation(T[:3, :3], flat) + T[:3, 3], target)
    assert impossible_as_rigid(flat, target, THRESHOLD, fit_of(T, flat, target)) is None


@pytest.mark.parametrize("factor", [0.992, 1.0, 1.005, 1.009])
def test_what_scanners_leave_is_no_finding(factor):
    source, target = endpoints(correspondence_problem(1000, 0.3, size=60.0))
    assert found_in(source, factor * target) is None


def test_a_rigid_pose_that_explains_nearly_as_much_is_kept():
    """A rigid pose that holds a part of the right matches; 600 of 1,000 agree under the similarity."""
    problem = correspondence_problem(1000, 0.4)
    source, target = endpoints(problem)
    right = problem.is_inlier.nonzero()[:, 0]
    for count, kind in ((250, Scaled), (450, Scaled), (520, type(None))):
        rigid = RigidFit(torch.zeros(1000, dtype=torch.bool).index_fill(0, right[:count], True), 50.0)
        assert isinstance(impossible_as_rigid(source, 1.2 * target, THRESHOLD, rigid), kind)


@pytest.mark.parametrize(("lost", "kind"), [(50, Mirrored), (300, type(None))])
def test_a_rigid_pose_with_matches_of_its_own_is_kept(lost, kind):
    problem = correspondence_problem(1000, 0.4)
    source, target = endpoints(problem)
    wrong = (~problem.is_inlier).nonzero()[:, 0]
    rigid = RigidFit(torch.zeros(1000, dtype=torch.bool).index_fill(0, wrong[:lost], True), 50.0)
    assert isinstance(impossible_as_rigid(source * FLIP, target, THRESHOLD, rigid), kind)


@pytest.mark.parametrize(("facing", "kind"), [(-0.9, Mirrored), (0.9, type(None)), (float("nan"), type(None))])
def test_less_speaks_for_a_reflection_where_the_rigid_pose_puts_surfaces_back_to_back(facing, kind):
    """As of a table top: the rigid pose turns it over and holds all but the 8 % of the matches that stand out of it."""
    problem = correspondence_problem(1000, 0.1)
    source, target = endpoints(problem)
    inliers = problem.is_inlier.clone()
    inliers[problem.is_inlier.nonzero()[:80, 0]] = False
    found = impossible_as_rigid(source * FLIP, target, THRESHOLD, RigidFit(inliers, 100.0, facing))
    assert isinstance(found, kind)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5])
def test_few_matches_are_no_impostors(count):
    points = numbers(count, 3)
    assert found_in(points * FLIP, points) is None


def test_the_failures_say_which_cloud_is_larger_with_figures():
    larger = scaled_failure(Scaled(1.1, 0.002, 1877), 2056, 1058)
    assert larger.text.startswith(
        "scaled: the target is 1.1 times as large as the source (1.1000 +- 0.0020): 1,877 of "
    )
    assert scaled_failure(Scaled(0.8, 0.002, 9), 10, 1).text.startswith(
        "scaled: the source is 1.25 times as large as the target (1.2500 +- 0.0031): "
    )
    assert larger.figures["factor"] == 1.1
    mirrored = mirrored_failure(Mirrored(3470), 4296, 195)
    assert mirrored.text == (
        "mirrored: 3,470 of 4,296 matches agree when one cloud is mirrored, 195 when it is not: a left-handed export?"
    )
    assert mirrored.figures == {"support": 3470, "matches": 4296, "rigid_support": 195}


def test_threads_change_no_bit():
    source, target = endpoints(correspondence_problem(3000, 0.6, place="room"))
    threads, found = torch.get_num_threads(), []
    try:
        for number in (1, 3):
            torch.set_num_threads(number)
            found.append((found_in(source, 1.2 * target), found_in(source * FLIP, target)))
    finally:
        torch.set_num_threads(threads)
    assert found[0] == found[1]
    assert None not in found[0]


def test_a_rigid_pair_has_no_failure():
    problem = correspondence_problem(500, 0.5)
    source, target = endpoints(problem)
    assert (
        impostor(MatchEndpoints(source, target), THRESHOLD, fit_of(problem.T_target_source[0], source, target)) is None
    )


@pytest.fixture(scope="module")
def impostors():
    """A right pair, the same mirrored, the same scaled, and a right pair again."""
    pair = room_pair(2500)
    target = pair.target
    mirrored = replace(target, points=target.points * FLIP.float(), viewpoint=target.viewpoint * FLIP.float())
    scaled = replace(target, points=1.2 * target.points, viewpoint=1.2 * target.viewpoint)
    return tr.Clouds.pack([pair.source] * 4), tr.Clouds.pack([target, mirrored, scaled, target])


def test_register_refuses_impostors_whatever_stands_beside_them(impostors):
    source, target = impostors
    result = tr.register(source, target)
    kinds = [None if failure is None else failure.kind for failure in result.failure]
    assert kinds == [None, "mirrored", "scaled", None]
    assert result.success.tolist() == [True, False, False, True]
    assert result.probability[1:3].tolist() == [0.0, 0.0]
    assert all(candidate.probability == 0 for pair in result.candidates[1:3] for candidate in pair)
    assert "radius" not in result.explain(1).partition("May help")[2]
    order = [2, 0, 1]
    other = tr.register(source.select(order), target.select(order))
    assert other.failure == tuple(result.failure[b] for b in order)
    assert same_bits(other.T_target_source, result.T_target_source[order])
    assert same_bits(other.probability, result.probability[order])
