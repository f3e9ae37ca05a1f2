"""Exact scores, refits that never get worse, and the least-squares fit to inliers."""

import oracles
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from problems import correspondence_problem, random_rotation

from torchreg.hypotheses.refine import best_first, by_count, by_msac, fit, optimize, score


def columns(problem):
    source = problem.source.points[problem.matches.source]
    target = problem.target.points[problem.matches.target]
    return source.t().contiguous(), target.t().contiguous()


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
    source, target = columns(problem)
    rotation, translation = near_truth(problem)
    scored = score(rotation, translation, source, target, 0.2)
    moved = torch.einsum("ijh,jm->him", rotation, source) + translation.t()[:, :, None]
    square = (moved - target).square().sum(dim=1)
    assert torch.equal(scored.inliers, square < 0.04)
    assert torch.equal(scored.support, scored.inliers.sum(dim=1))
    assert close(scored.error, torch.where(square < 0.04, square, 0).sum(dim=1), atol=1e-12)


def test_the_best_comes_first():
    problem = correspondence_problem(200)
    source, target = columns(problem)
    scored = score(*near_truth(problem, 20), source, target, 0.2)
    ordered = scored.take(best_first(scored))
    keys = list(zip((-ordered.support).tolist(), ordered.error.tolist(), strict=True))
    assert keys == sorted(keys)
    twice = scored.take(torch.tensor([3, 3, 3]))
    assert best_first(twice).tolist() == [0, 1, 2]


def test_the_fit_to_inliers_is_that_of_numpy():
    problem = correspondence_problem(300, noise=0.05)
    source, target = columns(problem)
    generator = torch.Generator().manual_seed(1)
    masks = torch.rand(5, 300, generator=generator) < 0.3
    masks[0] = problem.is_inlier
    rotation, translation = fit(masks, source, target)
    for h, mask in enumerate(masks):
        expected = oracles.kabsch(source[:, mask].t(), target[:, mask].t())
        assert close(rotation[..., h], expected[:3, :3], atol=1e-9)
        assert close(translation[:, h], expected[:3, 3], atol=1e-8)


def test_a_fit_to_nothing_is_a_rotation():
    source, target = columns(correspondence_problem(10))
    rotation, translation = fit(torch.zeros(1, 10, dtype=torch.bool), source, target)
    assert close(rotation[..., 0] @ rotation[..., 0].t(), torch.eye(3, dtype=torch.float64), atol=1e-12)
    assert torch.isfinite(translation).all()


def test_optimization_comes_closer_to_the_truth():
    problem = correspondence_problem(300, noise=0.05)
    source, target = columns(problem)
    before = score(*near_truth(problem, 8, step=0.01), source, target, 0.2)
    after = optimize(before, source, target, 0.2, 10)
    assert (after.support >= before.support).all()
    assert (after.support > before.support).any()
    assert (after.support >= problem.is_inlier.sum()).all()


def test_optimization_never_makes_a_hypothesis_worse():
    # agreement by chance: a fit to it often has fewer inliers than before
    problem = correspondence_problem(300, 1.0, size=3.0)
    source, target = columns(problem)
    generator = torch.Generator().manual_seed(2)
    rotation = torch.stack([random_rotation(generator) for _ in range(50)], dim=-1)
    moved = torch.einsum("ijh,j->ih", rotation, source.mean(dim=1))
    before = score(rotation, target.mean(dim=1)[:, None] - moved, source, target, 0.7)
    assert (score(*fit(before.inliers, source, target), source, target, 0.7).support < before.support).any()
    for rounds in (0, 1, 10):
        after = optimize(before, source, target, 0.7, rounds)
        assert (after.support >= before.support).all()
        equal = after.support == before.support
        assert (after.error[equal] <= before.error[equal]).all()
        assert same_bits(tuple(score(after.rotation, after.translation, source, target, 0.7)), tuple(after))
    assert same_bits(tuple(optimize(before, source, target, 0.7, 0)), tuple(before))


def test_a_hypothesis_has_its_bits_whatever_stands_beside_it():
    problem = correspondence_problem(2000, noise=0.05)
    source, target = columns(problem)
    rotation, translation = near_truth(problem, 9)
    together = optimize(score(rotation, translation, source, target, 0.2), source, target, 0.2, 5)
    for h in (0, 4, 8):
        start = score(rotation[..., h : h + 1], translation[:, h : h + 1], source, target, 0.2)
        alone = optimize(start, source, target, 0.2, 5)
        assert same_bits(tuple(alone), tuple(together.take(torch.tensor([h]))))


def test_the_number_of_threads_changes_nothing():
    problem = correspondence_problem(5000, noise=0.05)
    source, target = columns(problem)
    rotation, translation = near_truth(problem, 64)
    found = []
    for number in THREADS:
        with threads(number):
            start = score(rotation, translation, source, target, 0.2)
            found.append(tuple(optimize(start, source, target, 0.2, 5)))
    assert all(same_bits(one, found[0]) for one in found)


def test_msac_is_the_sum_of_what_is_left_of_the_threshold():
    problem = correspondence_problem(200, noise=0.05)
    source, target = columns(problem)
    rotation, translation = near_truth(problem)
    scored = score(rotation, translation, source, target, 0.2, by_msac)
    moved = torch.einsum("ijh,jm->him", rotation, source) + translation.t()[:, :, None]
    square = (moved - target).square().sum(dim=1)
    assert close(scored.quality, (1 - square / 0.04).clamp(min=0).sum(dim=1), atol=1e-9)
    counted = score(rotation, translation, source, target, 0.2, by_count)
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
        scored = score(rotation, step, source, target, 0.2, quality)
        assert scored.support.tolist() == [59, 60]
        first[quality] = int(best_first(scored)[0])
    assert first == {by_count: 1, by_msac: 0}
