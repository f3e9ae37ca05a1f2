"""Recall by both definitions, by hand-made values."""

import pytest
import torch
from refusals import refuses

import torchreg as tr

EYE = torch.eye(4, dtype=torch.float64)


def moved(meters, degrees):
    angle = torch.tensor(degrees, dtype=torch.float64).deg2rad()
    T = EYE.clone()
    T[0, 0] = T[1, 1] = angle.cos()
    T[1, 0] = angle.sin()
    T[0, 1] = -angle.sin()
    T[0, 3] = meters
    return T


def test_both_errors_must_be_below_their_bounds():
    estimated = torch.stack([moved(0.29, 14.9), moved(0.31, 1.0), moved(0.1, 15.1), moved(0.0, 0.0)])
    assert tr.metrics.recalled_by_error(EYE.expand(4, 4, 4), estimated).tolist() == [True, False, False, True]
    wide = tr.metrics.recalled_by_error(EYE.expand(4, 4, 4), estimated, rotation=20.0, translation=1.0)
    assert wide.tolist() == [True] * 4


def test_the_error_of_true_correspondences_must_be_below_its_bound():
    errors = torch.tensor([0.1, 0.2, 0.3])
    assert tr.metrics.recalled_by_rmse(errors).tolist() == [True, False, False]
    assert tr.metrics.recalled_by_rmse(errors, bound=0.25).tolist() == [True, True, False]


def test_recall_is_the_share_of_pairs():
    assert float(tr.metrics.registration_recall(torch.tensor([True, False, True, True]))) == 0.75


def test_an_error_that_is_no_number_is_not_recalled():
    assert tr.metrics.recalled_by_rmse(torch.tensor([float("nan")])).tolist() == [False]
    assert tr.metrics.recalled_by_error(EYE, EYE * float("nan")).tolist() is False


@pytest.mark.parametrize("bound", [0, -1.0, float("nan")])
def test_what_does_not_fit_is_refused(bound):
    with refuses("rotation", "above 0"):
        tr.metrics.recalled_by_error(EYE, EYE, rotation=bound)
    with refuses("translation", "above 0"):
        tr.metrics.recalled_by_error(EYE, EYE, translation=bound)
    with refuses("bound", "above 0"):
        tr.metrics.recalled_by_rmse(torch.zeros(1), bound=bound)


def test_recall_of_no_pairs_is_refused():
    with refuses("recalled", "at least one pair"):
        tr.metrics.registration_recall(torch.zeros(0, dtype=torch.bool))
