"""Pieces cover all rows once and keep to their budget."""

from hypothesis import given
from hypothesis import strategies as st

from torchreg.geometry.numerics.chunks import row_chunks


@given(st.integers(0, 500), st.integers(0, 50), st.integers(1, 2000))
def test_chunks_cover_all_rows_once(rows, width, elements):
    covered = [row for piece in row_chunks(rows, width, elements) for row in range(piece.start, piece.stop)]
    assert covered == list(range(rows))


@given(st.integers(1, 500), st.integers(1, 50), st.integers(1, 2000))
def test_chunks_keep_to_the_budget(rows, width, elements):
    longest = max(piece.stop - piece.start for piece in row_chunks(rows, width, elements))
    assert longest * width <= elements or longest == 1
