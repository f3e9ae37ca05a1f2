"""Offsets say where every item of a packed batch begins and ends."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from torchreg.types.packing import checked_offsets, offsets_of, spans


@given(st.lists(st.integers(0, 9), max_size=8))
def test_spans_undo_offsets(lengths):
    offsets = offsets_of(lengths)
    assert offsets.dtype == torch.int64
    assert [end - begin for begin, end in spans(offsets)] == lengths
    assert checked_offsets(offsets, sum(lengths)).tolist() == offsets.tolist()


def test_offsets_of_nothing():
    assert offsets_of([]).tolist() == [0]
    assert spans(offsets_of([])) == []
