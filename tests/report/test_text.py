"""Lengths as tables show them: millimeters for what a surveyor compares, meters for what lies far apart."""

import pytest

from torchreg.report.text import distance, millimeters


@pytest.mark.parametrize(
    ("meters", "text"),
    [
        ([0.0], "0 mm"),
        ([4e-19], "0 mm"),
        ([2.35e-5], "0.024 mm"),
        ([0.001, 0.00063], "1.0, 0.63 mm"),
        ([0.000997], "1.0 mm"),
        ([0.00996, 0.0103, 0.371], "10, 10, 371 mm"),
    ],
)
def test_millimeters_have_two_digits_at_least(meters, text):
    assert millimeters(*meters) == text


@pytest.mark.parametrize(
    ("meters", "text"), [(0.0003, "0.30 mm"), (0.0328, "33 mm"), (0.1, "0.1 m"), (22.123, "22.12 m")]
)
def test_a_distance_is_in_the_unit_that_shows_it(meters, text):
    assert distance(meters) == text
