"""A verification checks that all its fields have as many pairs, and hands on what the search holds."""

import pytest
import torch
from refusals import refuses
from results import number, verification

import torchreg as tr


@pytest.mark.parametrize(
    ("fields", "name", "parts"),
    [
        ({"T_target_source": torch.eye(4, dtype=torch.float64)}, "T_target_source", ["(1, 4, 4)", "(4, 4)"]),
        ({"settled": torch.eye(4)[None]}, "settled", ["float64", "float32"]),
        ({"likeliest": torch.eye(3)[None]}, "likeliest", ["(1, 4, 4)", "(1, 3, 3)"]),
        ({"success": torch.zeros(1)}, "success", ["bool", "float32"]),
        ({"success": torch.zeros(2, dtype=torch.bool)}, "success", ["(1,)", "(2,)"]),
        ({"probability": torch.zeros(2, dtype=torch.float64)}, "probability", ["(1,)", "(2,)"]),
        ({"deviation_meters": torch.zeros(1)}, "deviation_meters", ["float64", "float32"]),
        ({"failure": ()}, "failure", ["one or None per pair (1)", "0"]),
        ({"candidate": (None, None)}, "candidate", ["(1)", "2"]),
        ({"settled_candidate": ()}, "settled_candidate", ["(1)", "0"]),
        ({"rival": ()}, "rival", ["(1)", "0"]),
    ],
)
def test_what_does_not_fit_is_refused(fields, name, parts):
    with refuses(name, *parts):
        verification(**fields)


def test_clouds_options_notes_and_times_are_those_of_the_search():
    result = verification()
    assert len(result) == 1
    for name in ("source", "target", "options", "notes", "seconds"):
        assert getattr(result, name) is getattr(result.search, name)


def test_the_reason_is_the_text_of_the_failure():
    assert verification().reason == ("",)
    for kind in ("displaced", "another pose is better", "ambiguous"):
        failure = tr.Failure(kind, f"{kind}: so far")
        assert verification(failure=(failure,), probability=number(0)).reason == (f"{kind}: so far",)
