"""Soft selection of hypotheses: the best one in the limit, exact gradients, and weights that learn the inliers."""

import pytest
import torch
from closeness import close
from problems import columns, correspondence_problem, random_transform, seeded
from refusals import refuses
from torch.autograd import gradcheck, gradgradcheck

import torchreg as tr
from torchreg.learning import (
    draw_hypothesis,
    draw_samples,
    expected_loss,
    pose_loss,
    score_function_loss,
    select_softly,
)


def matched(count=60, outlier_ratio=0.5, seed=0):
    """Points of the correspondences (M, 3) twice, the true transform, and which are right."""
    problem = correspondence_problem(count, outlier_ratio, seed=seed)
    source, target = columns(problem)
    return source.t(), target.t(), problem.T_target_source[0], problem.is_inlier


def select(source, target, rows, **options):
    return select_softly(source, target, rows, inlier_threshold=0.3, **options)


def test_hypotheses_are_those_of_their_samples_and_scores_their_soft_inliers():
    source, target, _, _ = matched(20)
    rows = draw_samples(torch.zeros(20), 9, generator=seeded()).rows
    weights = torch.rand(20, dtype=torch.float64, generator=seeded())
    found = select(source, target, rows, weights=weights, softness=0.1, temperature=0.2)
    for h, sample in enumerate(rows):
        T = tr.kabsch(source[sample], target[sample])
        assert close(found.T_target_source[h], T, atol=1e-12)
        residual = (source @ T[:3, :3].t() + T[:3, 3] - target).norm(dim=1)
        score = (weights * torch.sigmoid((0.3 - residual) / 0.1)).sum() / weights.sum()
        assert close(found.score[h], score, atol=1e-12)
    assert close(found.probability, (found.score / 0.2).softmax(dim=0), atol=1e-12)
    assert close(found.log_probability.exp(), found.probability, atol=1e-12)


def test_the_true_pose_takes_the_probability_where_inliers_agree():
    source, target, true, is_inlier = matched(200, 0.6)
    samples = draw_samples(torch.zeros(200), 400, generator=seeded())
    found = select(source, target, samples.rows, temperature=0.02)
    right = is_inlier[samples.rows].all(dim=1)
    assert 5 < right.sum() < 100
    assert found.probability[right].sum() > 0.99
    assert expected_loss(found, pose_loss(found.T_target_source, true).total) < 0.2
    assert pose_loss(found.T_target_source, true).total.mean() > 2


def test_towards_temperature_zero_the_best_hypothesis_takes_all():
    source, target, _, _ = matched()
    rows = draw_samples(torch.zeros(60), 50, generator=seeded()).rows
    cold, warm = (select(source, target, rows, temperature=t) for t in (1e-6, 1e6))
    assert cold.probability.argmax() == warm.score.argmax()
    assert cold.probability.max() > 1 - 1e-9
    assert close(warm.probability, torch.full((50,), 1 / 50).double(), atol=1e-6)


def test_only_ratios_of_weights_matter_and_rows_of_weight_zero_do_not_count():
    source, target, _, is_inlier = matched()
    rows = draw_samples(is_inlier.double().log(), 20, generator=seeded()).rows
    weights = is_inlier.double()
    found = select(source, target, rows, weights=weights)
    scaled = select(source, target, rows, weights=7 * weights)
    assert close(found.score, scaled.score, atol=1e-12)
    garbage = torch.where(is_inlier[:, None], target, 1e3)
    assert close(select(source, garbage, rows, weights=weights).score, found.score, atol=1e-12)


def test_a_rigid_motion_of_the_target_moves_the_hypotheses_along():
    source, target, _, _ = matched()
    rows = draw_samples(torch.zeros(60), 20, generator=seeded()).rows
    T = random_transform(seeded(5))
    found = select(source, target, rows)
    moved = select(source, target @ T[:3, :3].t() + T[:3, 3], rows)
    assert close(moved.T_target_source, T @ found.T_target_source, atol=1e-9)
    assert close(moved.probability, found.probability, atol=1e-9)


def test_derivatives_are_exact_for_fixed_samples():
    source, target, true, _ = matched(7, 0.3)
    rows = draw_samples(torch.zeros(7), 5, generator=seeded()).rows
    weights = torch.rand(7, dtype=torch.float64, generator=seeded()) + 0.1

    def loss(source, target, weights):
        chosen = select_softly(source, target, rows, inlier_threshold=2.0, softness=1.0, weights=weights)
        return expected_loss(chosen, pose_loss(chosen.T_target_source, true).total)

    inputs = [value.clone().requires_grad_() for value in (source, target, weights)]
    assert gradcheck(loss, inputs)
    assert gradgradcheck(loss, inputs)


@pytest.mark.parametrize("made", ["coincident", "collinear", "exact", "no weight"])
def test_gradients_are_finite_for_samples_that_leave_the_rotation_open(made):
    source, target, true, _ = matched(6, 0.0)
    if made in ("coincident", "collinear"):
        along = torch.arange(6.0).double() if made == "collinear" else torch.ones(6).double()
        source, target = along[:, None] * source[:1], along[:, None] * target[:1]
    if made == "exact":
        target = source.clone()
    weights = torch.full((6,), 0.0 if made == "no weight" else 1.0).double()
    inputs = [value.clone().requires_grad_() for value in (source, target, weights)]
    rows = torch.tensor([[0, 1, 2], [3, 4, 5], [0, 0, 0]])
    chosen = select(inputs[0], inputs[1], rows, weights=inputs[2])
    loss = expected_loss(chosen, pose_loss(chosen.T_target_source, true).total)
    assert close(chosen.probability.sum(), torch.ones(()).double(), atol=1e-12)
    assert all(part.isfinite().all() for part in torch.autograd.grad(loss, inputs))


def test_a_hypothesis_is_drawn_by_its_probability():
    source, target, _, _ = matched()
    rows = draw_samples(torch.zeros(60), 4, generator=seeded()).rows
    chosen = select(source, target, rows, temperature=0.1)
    generator = seeded(1)
    drawn = [draw_hypothesis(chosen, generator=generator) for _ in range(3000)]
    often = torch.stack([one.hypothesis for one in drawn]).bincount(minlength=4) / 3000
    assert close(often.double(), chosen.probability, atol=0.04)
    one = drawn[0]
    assert torch.equal(one.T_target_source, chosen.T_target_source[one.hypothesis])
    assert torch.equal(one.log_probability, chosen.log_probability[one.hypothesis])
    assert (
        draw_hypothesis(chosen, generator=seeded(3)).hypothesis
        == draw_hypothesis(chosen, generator=seeded(3)).hypothesis
    )


def train(step, seed, steps):
    """Logits of matches trained by ``step``; their weight on inliers before and after, and the losses."""
    source, target, true, is_inlier = matched(40, 0.5, seed)
    logits = torch.zeros(40, dtype=torch.float64, requires_grad=True)
    optimizer, generator = torch.optim.Adam([logits], lr=0.1), seeded(seed)
    losses = []
    for _ in range(steps):
        optimizer.zero_grad()
        loss = step(source, target, true, logits, generator)
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    share = logits.detach().softmax(dim=0)[is_inlier].sum()
    return float(share), losses


@pytest.mark.parametrize("seed", [0, 1])
def test_weights_in_the_score_learn_the_inliers(seed):
    def step(source, target, true, logits, generator):
        samples = draw_samples(torch.zeros_like(logits), 64, generator=generator)
        chosen = select(source, target, samples.rows, weights=logits.sigmoid(), temperature=0.1)
        return expected_loss(chosen, pose_loss(chosen.T_target_source, true, translation_weight=0.1).total)

    share, losses = train(step, seed, 60)
    assert share > 0.8  # from 0.5
    assert sum(losses[-10:]) < 0.6 * sum(losses[:10])


@pytest.mark.parametrize("seed", [0, 1])
def test_weights_that_draw_the_samples_learn_the_inliers(seed):
    def step(source, target, true, logits, generator):
        samples = draw_samples(logits, 64, generator=generator)
        hypotheses = tr.kabsch(source[samples.rows], target[samples.rows])
        losses = pose_loss(hypotheses, true, translation_weight=0.1).total
        return score_function_loss(losses, samples.log_probability)

    share, losses = train(step, seed, 60)
    assert share > 0.9
    assert sum(losses[-10:]) < 0.5 * sum(losses[:10])


def test_what_does_not_fit_is_refused():
    points, rows = torch.zeros(5, 3), torch.zeros(2, 3, dtype=torch.int64)
    with refuses("target", "(5, 3)", "(4, 3)"):
        select(points, points[:4], rows)
    with refuses("samples", "int64", "float32"):
        select(points, points, rows.float())
    with refuses("samples", "at least one", "(0, 3)"):
        select(points, points, rows[:0])
    with refuses("weights", "(5,)", "(4,)"):
        select(points, points, rows, weights=torch.ones(4))
    with refuses("temperature", "above 0", "0"):
        select(points, points, rows, temperature=0)
    with refuses("losses", "(2,)", "(3,)"):
        expected_loss(select(points, points, rows), torch.zeros(3))
