"""How good correspondences are, by hand-made values and by problems of known truth."""

import pytest
import torch
from problems import correspondence_problem, matched, pack_problems
from refusals import refuses

import torchreg as tr

EYE = torch.eye(4, dtype=torch.float64)[None]


def test_hand_made_values():
    source = tr.Clouds(points=torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]))
    target = tr.Clouds(points=torch.tensor([[0.05, 0, 0], [1, 0.2, 0], [2, 0, 0], [3, 0, 0.125]]))
    rows = torch.arange(4)
    ratio = tr.metrics.inlier_ratio(source, target, matched(rows, rows), EYE, 0.125)
    assert ratio.dtype == torch.float64
    assert ratio.tolist() == [0.5]  # a distance of the threshold is out


@pytest.mark.parametrize("outlier_ratio", [0.0, 0.25, 0.9, 1.0])
def test_the_ratio_of_a_problem_is_known(outlier_ratio):
    problem = correspondence_problem(200, outlier_ratio, size=50.0)
    ratio = tr.metrics.inlier_ratio(*problem[:4], 0.1)
    assert ratio.tolist() == pytest.approx([1 - outlier_ratio], abs=0.006)


def test_origins_are_taken_into_account():
    problem = correspondence_problem(100, 0.5)
    at = torch.tensor([[5e5, 5e6, 1e2]], dtype=torch.float64)
    source = tr.Clouds(points=problem.source.points, origin=at)
    shift = EYE.clone()
    shift[0, :3, 3] = -at[0]
    expected = tr.metrics.inlier_ratio(*problem[:4], 0.1)
    T = problem.T_target_source @ shift
    assert tr.metrics.inlier_ratio(source, problem.target, problem.matches, T, 0.1).tolist() == expected.tolist()


def test_a_batch_equals_the_loop_over_its_pairs():
    problems = [correspondence_problem(50 + 10 * b, 0.2 * b, seed=b) for b in range(4)]
    none = torch.zeros(0, dtype=torch.int64)
    problems[2] = problems[2]._replace(matches=matched(none, none))
    T = torch.cat([problem.T_target_source for problem in problems])
    together = tr.metrics.inlier_ratio(*pack_problems(problems), T, 0.1)
    assert together.tolist() == [float(tr.metrics.inlier_ratio(*problem[:4], 0.1)) for problem in problems]
    assert together[2] == 0


def test_feature_match_recall_counts_pairs_above_the_least_ratio():
    ratios = torch.tensor([0.0, 0.05, 0.051, 0.8], dtype=torch.float64)
    assert float(tr.metrics.feature_match_recall(ratios)) == 0.5
    assert float(tr.metrics.feature_match_recall(ratios, 0.5)) == 0.25


def test_what_does_not_fit_is_refused():
    problem = correspondence_problem(10)
    with refuses("threshold", "above 0"):
        tr.metrics.inlier_ratio(*problem[:4], -1)
    with refuses("T_target_source", "(1, 4, 4)"):
        tr.metrics.inlier_ratio(*problem[:3], EYE[0], 0.1)
    with refuses("inlier_ratios", "(B,)", "(2, 2)"):
        tr.metrics.feature_match_recall(torch.zeros(2, 2))


def test_the_recall_of_no_pairs_is_refused():
    with pytest.raises(ValueError, match=r"^inlier_ratios: expected .+, got .+"):
        tr.metrics.feature_match_recall(torch.zeros(0))
