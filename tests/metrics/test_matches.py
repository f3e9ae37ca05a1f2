"""Correspondences under the truth: by hand-made values, problems of known truth, and a plain loop over points."""

import math
from dataclasses import replace

import pytest
import torch
from problems import correspondence_problem, matched, pack_problems, random_transform, room_pair, turned
from refusals import refuses

import torchreg as tr
from torchreg.geometry.se3 import apply, inverse, rigid
from torchreg.metrics import information_of_matches, rmse_by_information, rmse_of_true_matches

EYE = torch.eye(4, dtype=torch.float64)[None]


def a_little_off(meters, degrees, seed=0):
    g = torch.Generator().manual_seed(seed)
    direction = torch.nn.functional.normalize(torch.randn(3, dtype=torch.float64, generator=g), dim=0)
    return turned(degrees, torch.randn(3, generator=g).tolist(), (meters * direction).tolist())


def by_hand(pair, T_true, T_estimated, threshold):
    """Point by point, all distances at once."""
    moved = apply(T_true, pair.source.points.double() + pair.source.origin)
    target = pair.target.points.double() + pair.target.origin
    near = torch.cdist(moved, target).amin(dim=1) < threshold
    estimated = apply(T_estimated, pair.source.points.double() + pair.source.origin)
    return (estimated - moved)[near].square().sum(dim=1).mean().sqrt()


def test_hand_made_values():
    source = tr.Clouds(points=torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]))
    target = tr.Clouds(points=torch.tensor([[0.05, 0, 0], [1, 0.2, 0], [2, 0, 0], [3, 0, 0.125]]))
    rows = torch.arange(4)
    ratio = tr.metrics.inlier_ratio(source, target, matched(rows, rows), EYE, 0.125)
    assert ratio.dtype == torch.float64
    assert ratio.tolist() == [0.5]  # a distance of the threshold is out


def ratio_of(problem, threshold=0.1):
    return tr.metrics.inlier_ratio(problem.source, problem.target, problem.matches, problem.T_target_source, threshold)


@pytest.mark.parametrize("outlier_ratio", [0.0, 0.25, 0.9, 1.0])
def test_the_ratio_of_a_problem_is_known(outlier_ratio):
    ratio = ratio_of(correspondence_problem(200, outlier_ratio, size=50.0))
    assert ratio.tolist() == pytest.approx([1 - outlier_ratio], abs=0.006)


def test_origins_are_taken_into_account():
    problem = correspondence_problem(100, 0.5)
    at = torch.tensor([[5e5, 5e6, 1e2]], dtype=torch.float64)
    source = tr.Clouds(points=problem.source.points, origin=at)
    shift = EYE.clone()
    shift[0, :3, 3] = -at[0]
    expected = ratio_of(problem)
    T = problem.T_target_source @ shift
    assert tr.metrics.inlier_ratio(source, problem.target, problem.matches, T, 0.1).tolist() == expected.tolist()


def test_a_batch_equals_the_loop_over_its_pairs():
    problems = [correspondence_problem(50 + 10 * b, 0.2 * b, seed=b) for b in range(4)]
    none = torch.zeros(0, dtype=torch.int64)
    problems[2] = replace(problems[2], matches=matched(none, none))
    T = torch.cat([problem.T_target_source for problem in problems])
    together = tr.metrics.inlier_ratio(*pack_problems(problems), T, 0.1)
    assert together.tolist() == [float(ratio_of(problem)) for problem in problems]
    assert together[2] == 0


def test_feature_match_recall_counts_pairs_above_the_least_ratio():
    ratios = torch.tensor([0.0, 0.05, 0.051, 0.8], dtype=torch.float64)
    assert float(tr.metrics.feature_match_recall(ratios)) == 0.5
    assert float(tr.metrics.feature_match_recall(ratios, 0.5)) == 0.25


def test_what_does_not_fit_is_refused():
    problem = correspondence_problem(10)
    with refuses("threshold", "above 0"):
        ratio_of(problem, -1)
    with refuses("T_target_source", "(1, 4, 4)"):
        ratio_of(replace(problem, T_target_source=EYE[0]))
    with refuses("inlier_ratios", "(B,)", "(2, 2)"):
        tr.metrics.feature_match_recall(torch.zeros(2, 2))


def test_the_recall_of_no_pairs_is_refused():
    with pytest.raises(ValueError, match=r"^inlier_ratios: expected .+, got .+"):
        tr.metrics.feature_match_recall(torch.zeros(0))


def test_only_points_that_overlap_count():
    pair = room_pair(500, seed=1)
    T_true = pair.T_target_source
    T_estimated = T_true @ a_little_off(0.3, 20.0)
    expected = by_hand(pair, T_true[0], T_estimated[0], 0.15)
    error = rmse_of_true_matches(pair.source, pair.target, T_true, T_estimated, 0.15)
    assert torch.allclose(error, expected[None], rtol=1e-9)
    whole = tr.metrics.rmse(T_true[0], T_estimated[0], pair.source.points.double())
    assert abs(float(error) - float(whole)) > 1e-3  # so that the choice of points shows


def test_a_batch_and_origins_change_nothing():
    pairs = [room_pair(300, seed=seed) for seed in (1, 2)]
    T = torch.cat([pair.T_target_source for pair in pairs])
    off = T @ a_little_off(0.1, 5.0)
    shift = torch.tensor([[5e5, 4e6, 100.0]], dtype=torch.float64)
    source = tr.Clouds.pack([pair.source for pair in pairs])
    target = tr.Clouds.pack([pair.target for pair in pairs])
    error = rmse_of_true_matches(source, target, T, off, 0.15)
    alone = [rmse_of_true_matches(*pair[:2], T[b : b + 1], off[b : b + 1], 0.15) for b, pair in enumerate(pairs)]
    assert torch.equal(error, torch.cat(alone))
    far = tr.Clouds(points=pairs[0].source.points, origin=shift)
    there = rigid(torch.eye(3, dtype=torch.float64), shift[0])
    moved = [matrix[:1] @ inverse(there) for matrix in (T, off)]
    again = rmse_of_true_matches(far, pairs[0].target, *moved, 0.15)
    assert torch.allclose(again, error[:1], atol=1e-6)


def test_nothing_that_overlaps_is_an_infinite_error():
    pair = room_pair(200)
    away = pair.T_target_source.clone()
    away[0, :3, 3] += 100
    assert rmse_of_true_matches(pair.source, pair.target, away, away, 0.1).tolist() == [math.inf]
    assert rmse_by_information(away[0], away[0], torch.zeros(6, 6)).tolist() == math.inf


@pytest.mark.parametrize(("meters", "degrees", "within"), [(0.3, 0.0, 1e-9), (0.05, 2.0, 2e-3), (0.0, 40.0, 1e-9)])
def test_the_information_stands_for_the_points(meters, degrees, within):
    g = torch.Generator().manual_seed(3)
    points = 3 * torch.randn(200, 3, dtype=torch.float64, generator=g) + 2
    T_true = random_transform(g)
    T_estimated = T_true @ a_little_off(meters, degrees)
    error = rmse_by_information(T_true, T_estimated, information_of_matches(points))
    expected = tr.metrics.rmse(T_true, T_estimated, points)
    assert float(error) == pytest.approx(float(expected), rel=within)


def test_the_information_is_the_sum_over_its_points():
    p = torch.tensor([[1.0, 2.0, 3.0]])
    G = torch.tensor([[1, 0, 0, 0, 6, -4], [0, 1, 0, -6, 0, 2], [0, 0, 1, 4, -2, 0]], dtype=torch.float64)
    assert torch.equal(information_of_matches(p), G.t() @ G)
    assert torch.equal(information_of_matches(p.repeat(5, 1)), 5 * G.t() @ G)


def test_half_turns_are_finite_and_far():
    points = torch.randn(50, 3, generator=torch.Generator().manual_seed(0)).double()
    half = turned(180.0, [1.0, 2.0, 0.5])
    error = float(rmse_by_information(torch.eye(4), half, information_of_matches(points)))
    assert math.isfinite(error)
    assert error > 0.5


def test_errors_over_true_matches_refuse_what_does_not_fit():
    pair = room_pair(200)
    with refuses("threshold", "above 0"):
        rmse_of_true_matches(pair.source, pair.target, pair.T_target_source, pair.T_target_source, 0)
    with refuses("T_estimated", "(1, 4, 4)"):
        rmse_of_true_matches(pair.source, pair.target, pair.T_target_source, pair.T_target_source[0], 0.1)
    with refuses("information", "(..., 6, 6)"):
        rmse_by_information(torch.eye(4), torch.eye(4), torch.eye(4))
