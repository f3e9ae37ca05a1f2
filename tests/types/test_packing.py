"""Offsets say where every item of a packed batch begins and ends."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from torchreg.types.packing import checked_offsets, kept_rows, offsets_of, spans


@given(st.lists(st.integers(0, 9), max_size=8))
def test_spans_undo_offsets(lengths):
    offsets = offsets_of(lengths)
    assert offsets.dtype == torch.int64
    assert [end - begin for begin, end in spans(offsets)] == lengths
    assert checked_offsets(offsets, sum(lengths)).tolist() == offsets.tolist()


def test_offsets_of_nothing():
    assert offsets_of([]).tolist() == [0]
    assert spans(offsets_of([])) == []


@given(st.lists(st.tuples(st.integers(0, 9), st.booleans()), max_size=8))
def test_kept_rows_are_those_of_the_items_that_are_not_left_out(items):
    offsets = offsets_of(length for length, _ in items)
    left_out = [out for _, out in items]
    rows, kept = kept_rows(offsets, left_out)
    spans_and_marks = zip(spans(offsets), left_out, strict=True)
    assert rows.tolist() == [row for (begin, end), out in spans_and_marks if not out for row in range(begin, end)]
    assert [end - begin for begin, end in spans(kept)] == [0 if out else length for length, out in items]
