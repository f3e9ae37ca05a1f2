"""RANSAC on problems of known truth: found, refused with a reason, repeatable to the bit."""

from dataclasses import replace

import pytest
import torch
from closeness import assert_rigid, close
from determinism import assert_nothing_shows, same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import MatchProblem, correspondence_problem, matched, pack_problems
from refusals import refuses

import torchreg as tr
from torchreg.solvers.ransac.samples import FIRST_ROUND

EYE = torch.eye(4, dtype=torch.float64)
FEW = tr.RansacOptions(hypotheses=20_000)


def run(problem, options=None, seed=None):
    generator = None if seed is None else torch.Generator().manual_seed(seed)
    return tr.ransac(problem.source, problem.target, problem.matches, options, generator=generator)


def without(problem, rows):
    """The problem with these matches alone."""
    matches = matched(problem.matches.source[rows], problem.matches.target[rows])
    return replace(problem, matches=matches, is_inlier=problem.is_inlier[rows])


def assert_found(result, problem, degrees=0.5, meters=0.05):
    assert result.success.all()
    assert result.reason == ("",) * len(result)
    assert float(tr.metrics.rre(problem.T_target_source, result.T_target_source)) < degrees
    # the truth's own error at the points, where a small turn about a far origin does not show
    assert float(tr.metrics.rmse(problem.T_target_source, result.T_target_source, problem.source.points)) < meters


def assert_counts_agree(result, options):
    drawn, kept, scored = result.hypotheses
    assert ((scored <= kept) & (kept <= drawn) & (drawn <= options.hypotheses)).all()
    assert ((scored > 0) | ~result.success).all()


@pytest.mark.parametrize("outlier_ratio", [0.0, 0.5, 0.7, 0.8, 0.9])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_truth_is_found(outlier_ratio, dtype):
    for seed in range(3):
        problem = correspondence_problem(600, outlier_ratio, seed=seed, dtype=dtype)
        result = run(problem)
        assert_found(result, problem)
        assert_rigid(result.T_target_source, atol=1e-12)
        assert (result.inliers | ~problem.is_inlier).all()  # noise of 1 cm, threshold of 20
        assert result.inliers.sum() <= 1.1 * problem.is_inlier.sum() + 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_the_truth_is_found_among_95_percent_outliers(seed):
    problem = correspondence_problem(1000, 0.95, seed=seed)
    assert_found(run(problem, seed=seed), problem)


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.floats(0, 0.85), st.integers(30, 300))
def test_any_problem_is_found(seed, outlier_ratio, count):
    problem = correspondence_problem(count, outlier_ratio, seed=seed)
    if int(problem.is_inlier.sum()) >= 8:
        assert_found(run(problem, FEW, seed), problem, 1.0, 0.1)


def test_clean_matches_give_the_truth_to_rounding():
    problem = correspondence_problem(100, 0.3, noise=0.0)
    result = run(problem, FEW)
    assert close(result.T_target_source, problem.T_target_source, atol=1e-10)
    assert torch.equal(result.inliers, problem.is_inlier)
    assert float(result.inlier_rmse) < 0.2


def test_fitness_and_rmse_are_those_of_the_metrics():
    problem = correspondence_problem(300)
    result = run(problem, FEW)
    T, threshold = result.T_target_source, FEW.inlier_threshold
    assert torch.equal(result.fitness, tr.metrics.fitness(problem.source, problem.target, T, threshold))
    assert close(result.inlier_rmse, tr.metrics.inlier_rmse(problem.source, problem.target, T, threshold), atol=1e-12)


def test_inliers_are_the_matches_within_the_threshold():
    problem = correspondence_problem(300)
    result = run(problem, FEW)
    R, t = result.T_target_source[0, :3, :3], result.T_target_source[0, :3, 3]
    moved = problem.source.points[problem.matches.source] @ R.t() + t
    apart = (moved - problem.target.points[problem.matches.target]).norm(dim=1)
    assert torch.equal(result.inliers, apart < FEW.inlier_threshold)
    assert result.correspondences is problem.matches


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_matches_are_refused_with_a_reason(count):
    problem = without(correspondence_problem(50), slice(0, count))
    result = run(problem)
    assert result.success.tolist() == [False]
    assert result.reason[0].startswith(f"too few matches: {count}")
    assert torch.equal(result.T_target_source, EYE[None])
    assert [int(number) for number in result.hypotheses] == [0, 0, 0]
    assert result.fitness.tolist() == result.inlier_rmse.tolist() == [0]
    assert result.inliers.tolist() == [False] * count


def test_a_sample_of_four_needs_four_matches():
    problem = without(correspondence_problem(50, 0.0), slice(0, 3))
    result = run(problem, tr.RansacOptions(sample_size=4))
    assert result.success.tolist() == [False]
    assert "3, and a sample needs 4" in result.reason[0]


def test_matches_on_a_line_are_refused_with_a_reason():
    line = torch.arange(30.0)[:, None] * torch.tensor([[0.3, 0.1, -0.2]])
    one = tr.Clouds(points=line)
    rows = torch.arange(30)
    result = tr.ransac(one, one, matched(rows, rows), FEW)
    assert result.success.tolist() == [False]
    assert result.reason[0].startswith("no hypothesis left")
    assert torch.equal(result.T_target_source, EYE[None])


def test_matches_at_one_place_are_refused_with_a_reason():
    one = tr.Clouds(points=torch.ones(30, 3))
    rows = torch.arange(30)
    result = tr.ransac(one, one, matched(rows, rows), FEW)
    assert result.success.tolist() == [False]
    assert result.reason[0].startswith("no hypothesis left")


def test_edges_that_never_agree_are_refused_with_a_reason():
    points = torch.rand(40, 3, generator=torch.Generator().manual_seed(0))
    rows = torch.arange(40)
    result = tr.ransac(tr.Clouds(points=points), tr.Clouds(points=10 * points), matched(rows, rows), FEW)
    assert result.success.tolist() == [False]
    assert result.hypotheses.drawn.tolist() == [20_000]
    assert result.hypotheses.kept.tolist() == [0]


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_matched_point_that_is_not_finite_is_refused_with_a_reason(bad):
    problem = correspondence_problem(50)
    problem.source.points[3, 1] = bad
    result = run(problem)
    assert result.success.tolist() == [False]
    assert "not finite" in result.reason[0]


@pytest.mark.parametrize("side", ["source", "target"])
def test_a_point_that_is_not_finite_and_not_matched_is_no_exception(side):
    problem = correspondence_problem(50, 0.2)
    matches = problem.matches
    row = int(getattr(matches, side)[0])
    getattr(problem, side).points[row] = float("nan")
    result = run(without(problem, slice(1, 50)), FEW)
    assert len(result.reason) == 1


def test_three_good_matches_are_enough():
    problem = correspondence_problem(30, 0.0, noise=0.0)
    result = run(without(problem, slice(0, 3)), FEW)
    assert close(result.T_target_source, problem.T_target_source, atol=1e-6)


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.floats(0, 1), st.integers(3, 5), st.integers(0, 3))
def test_counts_and_rotations_hold_on_any_problem(seed, outlier_ratio, size, rounds):
    options = tr.RansacOptions(hypotheses=5000, sample_size=size, local_optimization=rounds)
    result = run(correspondence_problem(40, outlier_ratio, seed=seed, noise=0.1), options)
    assert_counts_agree(result, options)
    assert_rigid(result.T_target_source, atol=1e-12)


def test_a_mirrored_target_never_gives_a_reflection():
    problem = correspondence_problem(200, 0.0)
    mirror = torch.tensor([1.0, 1, -1], dtype=torch.float64)
    mirrored = tr.Clouds(points=problem.target.points * mirror)
    result = tr.ransac(problem.source, mirrored, problem.matches, FEW)
    assert_rigid(result.T_target_source, atol=1e-12)
    assert result.inliers.float().mean() < 0.5


def test_confidence_1_draws_everything():
    problem = correspondence_problem(200, 0.2)
    options = tr.RansacOptions(hypotheses=100_001, confidence=1.0)
    result = run(problem, options)
    assert result.hypotheses.drawn.tolist() == [100_001]
    assert_counts_agree(result, options)


def test_easy_problems_stop_early_and_hard_ones_later():
    options = tr.RansacOptions(hypotheses=600_000, confidence=0.999)
    drawn = [
        int(run(correspondence_problem(500, ratio, seed=4), options).hypotheses.drawn) for ratio in (0.2, 0.95, 1.0)
    ]
    assert drawn[0] == FIRST_ROUND
    assert FIRST_ROUND < drawn[1] < 600_000
    assert drawn[2] == 600_000
    calm = replace(options, confidence=0.5)
    assert int(run(correspondence_problem(500, 0.95, seed=4), calm).hypotheses.drawn) < drawn[1]


def test_no_more_hypotheses_than_asked():
    result = run(correspondence_problem(100), tr.RansacOptions(hypotheses=17))
    assert result.hypotheses.drawn.tolist() == [17]


def test_the_edge_test_drops_samples():
    problem = correspondence_problem(300)
    kept = []
    for similarity in (0.0, 0.5, 0.9, 0.99):
        options = tr.RansacOptions(hypotheses=20_000, confidence=1.0, edge_similarity=similarity)
        kept.append(int(run(problem, options).hypotheses.kept))
    assert kept == sorted(kept, reverse=True)
    assert kept[0] > 19_000  # all but samples that name a match twice
    assert kept[3] < kept[2] < kept[1] < kept[0]


@pytest.mark.parametrize("size", [4, 5])
def test_larger_samples_find_the_truth_too(size):
    problem = correspondence_problem(300, 0.5)
    assert_found(run(problem, tr.RansacOptions(sample_size=size, hypotheses=50_000)), problem)


def test_local_optimization_comes_closer():
    errors = []
    for rounds in (0, 10):
        options = tr.RansacOptions(hypotheses=2000, local_optimization=rounds, confidence=1.0)
        total = 0.0
        for seed in range(5):
            problem = correspondence_problem(300, 0.5, noise=0.05, seed=seed)
            found = run(problem, options).T_target_source
            total += float(tr.metrics.rmse(problem.T_target_source, found, problem.source.points))
        errors.append(total)
    assert errors[1] < 0.7 * errors[0]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_origins_of_utm_size_lose_nothing(dtype):
    problem = correspondence_problem(300, 0.7, noise=0.0, dtype=dtype)
    at = torch.tensor([[5e5, 5.4e6, 300.0]], dtype=torch.float64)
    to = torch.tensor([[4.2e5, 3.3e6, -20.0]], dtype=torch.float64)
    near = run(problem, FEW).T_target_source[0]
    source = tr.Clouds(points=problem.source.points, origin=at)
    target = tr.Clouds(points=problem.target.points, origin=to)
    result = tr.ransac(source, target, problem.matches, FEW)
    far = result.T_target_source[0]
    assert torch.equal(far[:3, :3], near[:3, :3])
    world = problem.source.points.double() + at
    expected = problem.source.points.double() @ near[:3, :3].t() + near[:3, 3] + to
    assert (world @ far[:3, :3].t() + far[:3, 3] - expected).abs().max() < 1e-6
    assert result.fitness.tolist() == run(problem, FEW).fitness.tolist()


def test_points_far_from_their_zero_are_found_as_well():
    problem = correspondence_problem(300, 0.7, size=10.0)
    shift = torch.tensor([[3e3, -2e3, 1e3]], dtype=torch.float64)
    source = tr.Clouds(points=problem.source.points + shift)
    result = tr.ransac(source, problem.target, problem.matches, FEW)
    assert torch.equal(result.inliers, run(problem, FEW).inliers)


def test_a_large_scene_with_a_small_threshold_is_found():
    # coordinates of 2 km in float32 are no good to a thousandth of a millimeter: proposals must be made in float64
    problem = correspondence_problem(300, 0.5, size=2000.0, noise=1e-8)
    result = run(problem, tr.RansacOptions(inlier_threshold=1e-6, hypotheses=50_000))
    assert result.success.all()
    assert (result.inliers == problem.is_inlier).float().mean() > 0.95


def test_swapped_clouds_give_about_the_inverse():
    problem = correspondence_problem(400, 0.7)
    forth = run(problem).T_target_source
    swapped = tr.Correspondences(
        problem.matches.target, problem.matches.source, problem.matches.offsets, problem.matches.score
    )
    back = tr.ransac(problem.target, problem.source, swapped).T_target_source
    assert close(forth @ back, EYE[None], atol=1e-9)


def test_the_same_generator_state_gives_the_same_bits():
    problem = correspondence_problem(60, 0.8, noise=0.05)  # so hard that the draws decide
    options = tr.RansacOptions(hypotheses=500, local_optimization=0)
    assert same_bits(run(problem, options, seed=3), run(problem, options, seed=3))
    assert not same_bits(run(problem, options, seed=3), run(problem, options, seed=4))
    assert same_bits(run(problem, options), run(problem, options))
    generator = torch.Generator().manual_seed(3)
    first, second = (
        tr.ransac(problem.source, problem.target, problem.matches, options, generator=generator) for _ in range(2)
    )
    assert same_bits(first, run(problem, options, seed=3))
    assert not same_bits(first, second)


def test_the_global_seed_is_left_alone_and_not_read():
    problem = correspondence_problem(60, 0.9)
    options = tr.RansacOptions(hypotheses=500)
    before = torch.get_rng_state()
    expected = run(problem, options)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(torch.initial_seed() + 1)
    assert same_bits(run(problem, options), expected)
    torch.set_rng_state(before)


def batch_of_problems():
    """Pairs of several sizes, failing ones among them."""
    made = [correspondence_problem(n, ratio, noise=0.03, seed=n) for n, ratio in ((60, 0.5), (200, 0.8), (33, 0.3))]
    lost = correspondence_problem(40, 0.0, seed=9)
    lost.source.points[5] = float("nan")
    line = torch.arange(10.0, dtype=torch.float64)[:, None].repeat(1, 3)
    flat = MatchProblem(
        tr.Clouds(points=line), tr.Clouds(points=line), matched(*[torch.arange(10)] * 2), EYE[None], torch.ones(10) > 0
    )
    bare = tr.Clouds(points=torch.zeros(0, 3, dtype=torch.float64))
    none = MatchProblem(bare, bare, matched(*[torch.zeros(0, dtype=torch.int64)] * 2), EYE[None], torch.ones(0) > 0)
    single = without(correspondence_problem(5), slice(0, 1))
    return [made[0], lost, none, made[1], flat, single, made[2]]


@pytest.mark.parametrize("confidence", [0.999, 1.0])
def test_a_batch_equals_the_loop_over_its_pairs(confidence):
    problems = batch_of_problems()
    options = tr.RansacOptions(hypotheses=20_000, confidence=confidence)
    alone = [run(problem, options, seed=11) for problem in problems]
    assert [bool(one.success) for one in alone] == [True, False, False, True, False, False, True]
    for order in (list(range(7)), [6, 4, 5, 0, 2, 1, 3], [3, 1]):
        chosen = [problems[b] for b in order]
        source, target, matches = pack_problems(chosen)
        together = tr.ransac(source, target, matches, options, generator=torch.Generator().manual_seed(11))
        for name in ("T_target_source", "inliers", "fitness", "inlier_rmse", "success"):
            assert same_bits(getattr(together, name), torch.cat([getattr(alone[b], name) for b in order])), name
        assert together.reason == tuple(alone[b].reason[0] for b in order)
        for field in tr.HypothesisCounts._fields:
            counts = torch.cat([getattr(alone[b].hypotheses, field) for b in order])
            assert torch.equal(getattr(together.hypotheses, field), counts)


def test_options_may_differ_from_pair_to_pair():
    problems = [correspondence_problem(100, 0.5, seed=seed) for seed in range(3)]
    each = [tr.RansacOptions(hypotheses=1000 + b, inlier_threshold=0.1 * (b + 1), confidence=1.0) for b in range(3)]
    together = tr.ransac(*pack_problems(problems), each)
    assert together.hypotheses.drawn.tolist() == [1000, 1001, 1002]
    for b, problem in enumerate(problems):
        assert same_bits(together.T_target_source[b], run(problem, each[b]).T_target_source[0])


@pytest.mark.parametrize("outlier_ratio", [0.6, 1.0])
def test_neither_threads_nor_tiles_change_a_bit(outlier_ratio):
    problem = correspondence_problem(900, outlier_ratio, noise=0.1, size=3.0)
    options = tr.RansacOptions(hypotheses=70_000, confidence=1.0)
    assert_nothing_shows(lambda: run(problem, options))


def test_neither_threads_nor_tiles_change_a_bit_where_residuals_meet_the_threshold():
    # on a grid of the threshold's step many residuals equal it but for rounding
    axis = torch.arange(7, dtype=torch.float64)
    grid = 0.2 * torch.cartesian_prod(axis, axis, axis)
    rows = torch.arange(len(grid))
    permuted = grid[torch.randperm(len(grid), generator=torch.Generator().manual_seed(0))]
    half = torch.where((rows % 3 == 0)[:, None], grid, permuted)
    source, target, matches = tr.Clouds(points=grid), tr.Clouds(points=half), matched(rows, rows)
    for confidence in (0.999, 1.0):
        options = tr.RansacOptions(hypotheses=40_000, confidence=confidence, inlier_threshold=0.2)
        assert_nothing_shows(lambda options=options: tr.ransac(source, target, matches, options))


def test_an_empty_batch_has_an_empty_result():
    none = tr.Clouds(points=torch.zeros(0, 3), offsets=torch.tensor([0]))
    rows = torch.zeros(0, dtype=torch.int64)
    result = tr.ransac(none, none, tr.Correspondences(rows, rows, torch.tensor([0]), torch.zeros(0)))
    assert len(result) == 0
    assert result.reason == ()


def test_what_does_not_fit_is_refused():
    problem = correspondence_problem(20)
    two = tr.Clouds.pack([problem.source, problem.source])
    with refuses("matches", "2 pairs", "1"):
        tr.ransac(two, two, problem.matches)
    with refuses("options", "(1)", "2"):
        tr.ransac(problem.source, problem.target, problem.matches, [FEW, FEW])
    rows = torch.tensor([0, 1, 20])
    with refuses("matches.source", "0 to 19"):
        tr.ransac(problem.source, problem.target, matched(rows, rows[:3] % 20))
    with refuses("matches.target", "0 to 19"):
        tr.ransac(problem.source, problem.target, matched(rows % 20, -rows))


def test_a_match_into_another_pair_is_refused():
    source, target, matches = pack_problems([correspondence_problem(20, seed=seed) for seed in range(2)])
    crossed = matches.target.clone()
    crossed[0] = 25
    with refuses("matches.target", "0 to 19"):
        tr.ransac(source, target, replace(matches, target=crossed))


@pytest.mark.parametrize("sides", [(1, 2), (2, 1)])
def test_sides_of_different_numbers_are_refused(sides):
    problem = correspondence_problem(20)
    source, target = (tr.Clouds.pack([problem.source] * number) for number in sides)
    with pytest.raises(ValueError, match=r"^(matches|target): expected .+, got .+"):
        tr.ransac(source, target, problem.matches)


def test_scorings_choose_differently_and_stop_alike():
    differ = 0
    for seed in range(6):
        problem = correspondence_problem(200, 0.8, noise=0.1, seed=seed)
        options = [tr.RansacOptions(scoring=scoring, local_optimization=0) for scoring in ("count", "msac")]
        counted, weighed = (run(problem, option) for option in options)
        assert torch.equal(counted.hypotheses.drawn, weighed.hypotheses.drawn)
        assert counted.inliers.sum() >= weighed.inliers.sum()
        differ += not same_bits(counted.T_target_source, weighed.T_target_source)
    assert differ >= 2
    with refuses("scoring", "count", "best"):
        tr.RansacOptions(scoring="best")
