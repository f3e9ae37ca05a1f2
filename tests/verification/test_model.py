"""Probabilities: of distinct candidates, at most one right."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchreg.verification.evidence import Evidence
from torchreg.verification.model import MODEL, PRIOR, log_odds, probabilities, terms
from torchreg.verification.reasons import accepted

odds = st.lists(st.floats(-700, 700), min_size=1, max_size=20)


@given(odds)
def test_probabilities_leave_room_for_none(values):
    found = probabilities(torch.tensor(values, dtype=torch.float64))
    assert bool(torch.isfinite(found).all())
    assert bool((found >= 0).all())
    assert float(found.sum()) <= 1 + 1e-12


@given(st.floats(-30, 30))
def test_one_candidate_is_a_logistic(value):
    found = probabilities(torch.tensor([value], dtype=torch.float64))
    assert float(found) == pytest.approx(float(torch.sigmoid(torch.tensor(value, dtype=torch.float64))), abs=1e-12)


@given(odds, st.floats(-700, 700))
def test_a_rival_never_helps(values, rival):
    alone = probabilities(torch.tensor(values, dtype=torch.float64))
    beside = probabilities(torch.tensor([*values, rival], dtype=torch.float64))
    assert bool((beside[:-1] <= alone + 1e-12).all())


def test_equals_share():
    found = probabilities(torch.tensor([9.0, 9.0], dtype=torch.float64))
    assert float(found[0]) == float(found[1])
    assert 0.49 < float(found[0]) < 0.5


def test_no_candidate_has_no_probability():
    assert probabilities(torch.zeros(0, dtype=torch.float64)).shape == (0,)


BASE = {"overlap": 0.25, "closeness": 0.8, "normals": 0.9, "colors": 0.7, "strength": 0.15, "conflict": 0.01}


def weighed(surprise=15.0, **changed):
    values = {**BASE, **changed}
    seen = Evidence(**{name: torch.tensor([value], dtype=torch.float64) for name, value in values.items()})
    return float(log_odds(seen, torch.tensor([surprise], dtype=torch.float64)))


@pytest.mark.parametrize(
    ("name", "worse"),
    [("overlap", 0.1), ("closeness", 0.6), ("normals", 0.5), ("colors", 0.2), ("strength", 0.05), ("conflict", 0.2)],
)
def test_less_evidence_lowers_the_odds(name, worse):
    assert weighed(**{name: worse}) < weighed()


def test_fewer_matches_lower_the_odds():
    assert weighed(surprise=5.0) < weighed()


def test_missing_evidence_stays_finite():
    nothing = float("nan")
    assert torch.isfinite(torch.tensor(weighed(colors=nothing, conflict=nothing, normals=nothing)))
    assert torch.isfinite(torch.tensor(weighed(overlap=0.0, colors=1.0, conflict=1.0, surprise=1e9)))


def test_every_term_has_a_name_a_weight_and_a_typical_value():
    seen = Evidence(*(torch.zeros(1, dtype=torch.float64) for _ in Evidence._fields))
    width = terms(seen, torch.zeros(1, dtype=torch.float64)).shape[1]
    assert width == len(MODEL)
    assert list(MODEL) == list(PRIOR)


@pytest.mark.parametrize(
    ("probability", "odds", "expected"),
    [(0.9, [3.0], True), (0.9, [3.0, 0.5], True), (0.9, [3.0, 2.5], False), (0.5, [0.1], False)],
)
def test_a_success_is_probable_and_ahead_of_its_runner_up(probability, odds, expected):
    assert accepted(probability, torch.tensor(odds, dtype=torch.float64)) is expected
