"""The factor at which ratios of lengths peak, and the support that the peak implies."""

import pytest
import torch
from problems import columns, correspondence_problem

from torchreg.verification.length_ratios import length_ratios

THRESHOLD = 0.05


def endpoints(problem):
    source, target = columns(problem, torch.float64)
    return source.t(), target.t()


@pytest.mark.parametrize("factor", [0.4, 0.85, 0.95, 1.05, 1.2, 3.2808])
@pytest.mark.parametrize("outliers", [0.3, 0.8])
def test_the_peak_stands_at_the_factor_and_implies_the_support(factor, outliers):
    problem = correspondence_problem(1000, outliers)
    source, target = endpoints(problem)
    ratios = length_ratios(source, factor * target, THRESHOLD)
    assert ratios.factor == pytest.approx(factor, rel=0.015)
    assert ratios.support == pytest.approx(int(problem.is_inlier.sum()), rel=0.25)
    assert ratios.support_at_one < 0.5 * ratios.support


@pytest.mark.parametrize("place", ["cube", "room"])
def test_a_rigid_problem_peaks_at_one(place):
    ratios = length_ratios(*endpoints(correspondence_problem(1000, 0.7, place=place)), THRESHOLD)
    assert ratios.factor == 1.0
    assert ratios.support == ratios.support_at_one


def test_lengths_do_not_see_a_reflection_and_a_rigid_motion():
    source, target = endpoints(correspondence_problem(500, 0.5))
    through = source * torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    assert length_ratios(through, target, THRESHOLD) == length_ratios(source, target, THRESHOLD)


def test_unrelated_matches_imply_little():
    ratios = length_ratios(*endpoints(correspondence_problem(1000, 1.0)), THRESHOLD)
    assert ratios.support < 100


@pytest.mark.parametrize("count", [20, 2000, 40_000])
def test_any_number_of_matches(count):
    source, target = endpoints(correspondence_problem(count, 0.0))
    assert length_ratios(source, 1.2 * target, THRESHOLD).factor == pytest.approx(1.2, rel=0.02)


def test_points_in_one_place_imply_nothing():
    same = torch.ones(20, 3, dtype=torch.float64)
    assert length_ratios(same, same, THRESHOLD).support == 0.0


@pytest.mark.parametrize("count", [2, 3])
def test_too_few_matches_to_tell_peaks_from_chance(count):
    source, target = endpoints(correspondence_problem(count, 0.0))
    assert length_ratios(source, target, THRESHOLD).support <= count * 2**0.5
