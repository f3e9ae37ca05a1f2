"""Exact scores, refits that never get worse, and the least-squares fit to inliers."""

import oracles
import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from problems import columns, correspondence_problem, random_rotation

from torchreg.solvers.local_optimization import fit, optimize
from torchreg.solvers.points import PairPoints
from torchreg.solvers.scoring import by_count, by_msac, score

CENTERS = (torch.zeros(1, 3, dtype=torch.float64),) * 2


def one_pair(source, target, threshold=0.2):
    """The points (3, M) twice of a single pair."""
    valid = torch.ones(1, source.shape[1], dtype=torch.bool)
    return PairPoints(
        source[:, None], target[:, None], valid, valid.double(), (source.shape[1],), (threshold,), *CENTERS, (0,)
    )


def side_by_side(pairs):
    """The points of several pairs, with zeros behind the last of each, which would agree with one another."""
    counts = [pair.source.shape[2] for pair in pairs]
    width = max(counts) + 3
    sides = [
        torch.cat([torch.nn.functional.pad(side, (0, width - side.shape[2])) for side in part], dim=1)
        for part in ([pair.source for pair in pairs], [pair.target for pair in pairs])
    ]
    valid = torch.arange(width) < torch.tensor(counts)[:, None]
    thresholds = tuple(pair.thresholds[0] for pair in pairs)
    centers = (center.expand(len(pairs), 3) for center in CENTERS)
    return PairPoints(*sides, valid, valid.double(), tuple(counts), thresholds, *centers, (0,) * len(pairs))


def all_of(pair, count):
    """The number of a pair for so many of its hypotheses."""
    return torch.full((count,), pair)


def scores(rotation, translation, points, quality=by_count):
    """Of hypotheses of a single pair."""
    return score(rotation, translation, all_of(0, translation.shape[1]), points, quality)


def near_truth(problem, count=6, step=0.02, seed=0):
    """Hypotheses (3, 3, H), (3, H) around the true transform."""
    generator = torch.Generator().manual_seed(seed)
    R, t = problem.T_target_source[0, :3, :3], problem.T_target_source[0, :3, 3]
    twist = step * torch.randn(count, 3, 3, dtype=torch.float64, generator=generator)
    turned = torch.matrix_exp(twist - twist.transpose(1, 2)) @ R
    moved = t + step * torch.randn(count, 3, dtype=torch.float64, generator=generator)
    return turned.permute(1, 2, 0).contiguous(), moved.t().contiguous()


def test_scores_are_counts_and_errors_of_residuals():
    problem = correspondence_problem(200)
    points = one_pair(*columns(problem))
    rotation, translation = near_truth(problem)
    scored = scores(rotation, translation, points)
    moved = torch.einsum("ijh,jm->him", rotation, points.source[:, 0]) + translation.t()[:, :, None]
    square = (moved - points.target[:, 0]).square().sum(dim=1)
    assert torch.equal(scored.inliers, square < 0.04)
    assert torch.equal(scored.support, scored.inliers.sum(dim=1))
    assert close(scored.error, torch.where(square < 0.04, square, 0).sum(dim=1), atol=1e-12)


def test_the_best_comes_first():
    problem = correspondence_problem(200)
    points = one_pair(*columns(problem))
    scored = scores(*near_truth(problem, 20), points)
    ordered = scored.take(scored.best_first())
    keys = list(zip((-ordered.support).tolist(), ordered.error.tolist(), strict=True))
    assert keys == sorted(keys)
    twice = scored.take(torch.tensor([3, 3, 3]))
    assert twice.best_first().tolist() == [0, 1, 2]


def test_the_fit_to_inliers_is_that_of_numpy():
    problem = correspondence_problem(300, noise=0.05)
    points = one_pair(*columns(problem))
    generator = torch.Generator().manual_seed(1)
    masks = torch.rand(5, 300, generator=generator) < 0.3
    masks[0] = problem.is_inlier
    rotation, translation = fit(masks, all_of(0, 5), points)
    for h, mask in enumerate(masks):
        expected = oracles.kabsch(points.source[:, 0, mask].t(), points.target[:, 0, mask].t())
        assert close(rotation[..., h], expected[:3, :3], atol=1e-9)
        assert close(translation[:, h], expected[:3, 3], atol=1e-8)


def test_a_fit_to_nothing_is_a_rotation():
    points = one_pair(*columns(correspondence_problem(10)))
    rotation, translation = fit(torch.zeros(1, 10, dtype=torch.bool), all_of(0, 1), points)
    assert close(rotation[..., 0] @ rotation[..., 0].t(), torch.eye(3, dtype=torch.float64), atol=1e-12)
    assert torch.isfinite(translation).all()


def test_optimization_comes_closer_to_the_truth():
    problem = correspondence_problem(300, noise=0.05, seed=1)
    points = one_pair(*columns(problem))
    before = scores(*near_truth(problem, 8, step=0.01), points)
    after = optimize(before, points, 10)
    assert (after.support >= before.support).all()
    assert (after.support > before.support).any()
    assert (after.support >= problem.is_inlier.sum()).all()


def test_optimization_never_makes_a_hypothesis_worse():
    # agreement by chance: a fit to it often has fewer inliers than before
    problem = correspondence_problem(300, 1.0, size=3.0)
    source, target = columns(problem)
    points = one_pair(source, target, 0.7)
    generator = torch.Generator().manual_seed(2)
    rotation = torch.stack([random_rotation(generator) for _ in range(50)], dim=-1)
    moved = torch.einsum("ijh,j->ih", rotation, source.mean(dim=1))
    before = scores(rotation, target.mean(dim=1)[:, None] - moved, points)
    assert (scores(*fit(before.inliers, before.pair, points), points).support < before.support).any()
    for rounds in (0, 1, 10):
        after = optimize(before, points, rounds)
        assert (after.support >= before.support).all()
        equal = after.support == before.support
        assert (after.error[equal] <= before.error[equal]).all()
        assert same_bits(tuple(scores(after.rotation, after.translation, points)), tuple(after))
    assert same_bits(tuple(optimize(before, points, 0)), tuple(before))


def test_a_hypothesis_has_its_bits_whatever_stands_beside_it():
    problem = correspondence_problem(2000, noise=0.05)
    points = one_pair(*columns(problem))
    rotation, translation = near_truth(problem, 9)
    together = optimize(scores(rotation, translation, points), points, 5)
    for h in (0, 4, 8):
        start = scores(rotation[..., h : h + 1], translation[:, h : h + 1], points)
        alone = optimize(start, points, 5)
        assert same_bits(tuple(alone), tuple(together.take(torch.tensor([h]))))


def test_a_pair_has_its_bits_whatever_pairs_stand_beside_it():
    problems = [correspondence_problem(count, 0.7, noise=0.05, seed=count) for count in (1500, 40, 300, 1024)]
    singles = [one_pair(*columns(problem), 0.1 * (place + 1)) for place, problem in enumerate(problems)]
    near = [near_truth(problem, 7, seed=place) for place, problem in enumerate(problems)]
    pair = torch.arange(4).repeat_interleave(7)
    beside = side_by_side(singles)
    poses = (torch.cat(part, dim=-1) for part in zip(*near, strict=True))
    scored = score(*poses, pair, beside, by_msac)
    together = optimize(scored, beside, 5, by_msac)
    together = together.take(together.best_first())
    for place, points in enumerate(singles):
        alone = optimize(scores(*near[place], points, by_msac), points, 5, by_msac)
        alone = alone.take(alone.best_first())
        own = together.take((together.pair == place).nonzero()[:, 0])
        assert not own.inliers[:, points.counts[0] :].any()
        own = own._replace(pair=alone.pair, inliers=own.inliers[:, : points.counts[0]])
        assert same_bits(tuple(own), tuple(alone))


@pytest.mark.parametrize("elements", [1, 5000])
def test_the_size_of_the_pieces_changes_nothing(elements, monkeypatch):
    problem = correspondence_problem(1100, noise=0.05)
    points = one_pair(*columns(problem))
    start = scores(*near_truth(problem, 9), points)
    expected = optimize(start, points, 3)
    monkeypatch.setattr("torchreg.solvers.local_optimization._SUM_ELEMENTS", elements)
    monkeypatch.setattr("torchreg.solvers.scoring._SCORE_ELEMENTS", elements)
    assert same_bits(tuple(scores(*near_truth(problem, 9), points)), tuple(start))
    assert same_bits(tuple(optimize(start, points, 3)), tuple(expected))


def test_the_number_of_threads_changes_nothing():
    problem = correspondence_problem(5000, noise=0.05)
    points = one_pair(*columns(problem))
    rotation, translation = near_truth(problem, 64)
    found = []
    for number in THREADS:
        with threads(number):
            start = scores(rotation, translation, points)
            found.append(tuple(optimize(start, points, 5)))
    assert all(same_bits(one, found[0]) for one in found)


def test_msac_is_the_sum_of_what_is_left_of_the_threshold():
    problem = correspondence_problem(200, noise=0.05)
    points = one_pair(*columns(problem))
    rotation, translation = near_truth(problem)
    scored = scores(rotation, translation, points, by_msac)
    moved = torch.einsum("ijh,jm->him", rotation, points.source[:, 0]) + translation.t()[:, :, None]
    square = (moved - points.target[:, 0]).square().sum(dim=1)
    assert close(scored.quality, (1 - square / 0.04).clamp(min=0).sum(dim=1), atol=1e-9)
    counted = scores(rotation, translation, points, by_count)
    assert torch.equal(counted.quality, counted.support.double())
    assert torch.equal(counted.support, scored.support)


def test_msac_prefers_a_closer_fit_to_one_more_inlier():
    source = torch.randn(3, 60, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    target = source.clone()
    target[0, 0] += 0.25  # an outlier of the identity that a step of 0.1 takes in
    rotation = torch.eye(3, dtype=torch.float64)[..., None].expand(3, 3, 2)
    step = torch.tensor([[0.0, 0.1], [0, 0], [0, 0]], dtype=torch.float64)
    first = {}
    for quality in (by_count, by_msac):
        scored = scores(rotation, step, one_pair(source, target), quality)
        assert scored.support.tolist() == [59, 60]
        first[quality] = int(scored.best_first()[0])
    assert first == {by_count: 1, by_msac: 0}
