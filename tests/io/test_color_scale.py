"""Colors of every depth become [0, 1]; what cannot be told is left out, and a note says so."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchreg.io.assemble import scale_colors


def one(*values, dtype):
    return np.array([values], dtype=dtype)


@pytest.mark.parametrize(
    ("colors", "expected", "depth"),
    [
        (one(255, 51, 0, dtype="u1"), [1, 0.2, 0], "uint8"),
        (one(65535, 13107, 0, dtype="u2"), [1, 0.2, 0], "uint16"),
        (one(255, 51, 0, dtype="i4"), [1, 0.2, 0], "uint8"),
        (one(65535, 13107, 0, dtype="u4"), [1, 0.2, 0], "uint16"),
        (one(1.0, 0.2, 0, dtype="f8"), [1, 0.2, 0], "float"),
        (one(255.0, 51.0, 0, dtype="f4"), [1, 0.2, 0], "float"),
        (one(65535.0, 13107.0, 0, dtype="f8"), [1, 0.2, 0], "float"),
        (one(1.0005, 0.2, -0.0005, dtype="f8"), [1, 0.2, 0], "float"),
    ],
)
def test_depths(colors, expected, depth):
    scaled = scale_colors(colors)
    np.testing.assert_allclose(scaled.values, [expected], atol=1e-15)
    assert scaled.depth == depth


@pytest.mark.parametrize(
    "colors",
    [
        one(-1, 0, 0, dtype="i4"),
        one(65536, 0, 0, dtype="i4"),
        one(1.5, 0, 0, dtype="f4"),
        one(15.9, 0, 0, dtype="f4"),
        one(255.5, 0, 0, dtype="f4"),
        one(65536.0, 0, 0, dtype="f4"),
        one(1e300, 0, 0, dtype="f8"),
        one(-0.01, 1, 0, dtype="f4"),
        one(-3, 200, 0, dtype="f4"),
    ],
)
def test_what_cannot_be_told_is_left_out(colors):
    scaled = scale_colors(colors)
    assert scaled.values is None
    assert re.match(r"read without colors: expected (floats|integers) .*, got .* to ", scaled.notes[0])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_color_that_is_not_finite_is_black(bad):
    scaled = scale_colors(np.array([[0.5, bad, 0.5], [0.1, 0.2, 1.0]]))
    assert scaled.values.tolist() == [[0, 0, 0], [0.1, 0.2, 1]]
    assert scaled.notes == ("1 colors are not finite and were made black",)
    assert scale_colors(np.full((2, 3), bad)).values is None


def test_guesses_are_noted():
    assert "divided by 255" in scale_colors(one(200.0, 0, 0, dtype="f4")).notes[0]
    assert "divided by 65535" in scale_colors(one(2000.0, 0, 0, dtype="f4")).notes[0]
    assert "16-bit colors reach only 200" in scale_colors(one(200, 0, 0, dtype="u2")).notes[0]
    assert scale_colors(one(256, 0, 0, dtype="u2")).notes == ()


@given(st.lists(st.tuples(*[st.integers(0, 255)] * 3), min_size=1))
def test_eight_bits_come_back_exactly(rows):
    colors = np.array(rows, dtype="u1")
    assert (np.round(scale_colors(colors).values * 255) == colors).all()
