"""Probabilities: of distinct candidates, at most one right."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchreg.verification.model import (
    TERMS,
    WEIGHTS,
    Evidence,
    Term,
    load_terms,
    log_odds,
    probabilities,
    save_terms,
    term_values,
)

odds = st.lists(st.floats(-700, 700), min_size=1, max_size=20)


@given(odds)
def test_probabilities_leave_room_for_none(values):
    shares = probabilities(torch.tensor(values, dtype=torch.float64))
    assert bool(torch.isfinite(shares).all())
    assert bool((shares >= 0).all())
    assert float(shares.sum()) <= 1 + 1e-12


@given(st.floats(-30, 30))
def test_one_candidate_is_a_logistic(value):
    shares = probabilities(torch.tensor([value], dtype=torch.float64))
    assert float(shares) == pytest.approx(float(torch.sigmoid(torch.tensor(value, dtype=torch.float64))), abs=1e-12)


@given(odds, st.floats(-700, 700))
def test_a_rival_never_helps(values, rival):
    alone = probabilities(torch.tensor(values, dtype=torch.float64))
    beside = probabilities(torch.tensor([*values, rival], dtype=torch.float64))
    assert bool((beside[:-1] <= alone + 1e-12).all())


def test_equals_share():
    shares = probabilities(torch.tensor([9.0, 9.0], dtype=torch.float64))
    assert float(shares[0]) == float(shares[1])
    assert 0.49 < float(shares[0]) < 0.5


def test_no_candidate_has_no_probability():
    assert probabilities(torch.zeros(0, dtype=torch.float64)).shape == (0,)


BASE = {
    **{"overlap": 0.25, "closeness": 0.8, "normals": 0.9, "colors": 0.7, "strength": 0.15, "conflict": 0.01},
    **{"misses": 0.3, "features": 0.5, "color_features": 0.5},
}


def weighed(surprise=15.0, **changed):
    values = {**BASE, **changed}
    seen = Evidence(**{name: torch.tensor([value], dtype=torch.float64) for name, value in values.items()})
    return float(log_odds(seen, torch.tensor([surprise], dtype=torch.float64)))


@pytest.mark.parametrize(
    ("name", "worse"),
    [
        *(("overlap", 0.1), ("closeness", 0.6), ("normals", 0.5), ("colors", 0.2), ("strength", 0.05)),
        *(("conflict", 0.2), ("misses", 0.6), ("features", 0.1), ("color_features", 0.0)),
    ],
)
def test_less_evidence_lowers_the_odds(name, worse):
    assert weighed(**{name: worse}) < weighed()


def test_fewer_matches_lower_the_odds():
    assert weighed(surprise=5.0) < weighed()


def test_missing_evidence_stays_finite():
    nothing = float("nan")
    assert torch.isfinite(torch.tensor(weighed(colors=nothing, conflict=nothing, normals=nothing)))
    assert torch.isfinite(torch.tensor(weighed(features=nothing, color_features=nothing, misses=1.0)))
    assert torch.isfinite(torch.tensor(weighed(closeness=0.0, features=1.0, color_features=-1.0)))
    assert torch.isfinite(torch.tensor(weighed(overlap=0.0, colors=1.0, conflict=1.0, surprise=1e9)))


def test_every_term_has_a_column():
    nothing = Evidence(*(torch.zeros(1, dtype=torch.float64) for _ in Evidence._fields))
    assert term_values(nothing, torch.zeros(1, dtype=torch.float64)).shape == (1, len(TERMS))


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=5, max_size=5))
def test_weights_keep_every_bit_in_their_file(numbers):
    terms = {"one": Term(*numbers), "overlap": Term(*numbers[:3]), "surprise": Term(*numbers[:3], high=numbers[3])}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "weights.json"
        save_terms(terms, {"command": "by hand"}, path)
        assert load_terms(path) == terms
        assert list(load_terms(path)) == list(terms)
        assert str(load_terms(path)) == str(terms)  # a negative zero too


def test_the_weights_tell_where_they_come_from():
    content = json.loads(WEIGHTS.read_text())
    assert content["command"].startswith("python bench/verdict.py")
    assert sum(content["fitted"]["cases"].values()) == 453
    for key in ("how", "effort", "commit"):
        assert content["fitted"][key]
    assert content["validated"]["machine"]["commit"]
    assert load_terms() == TERMS
