"""Batches take an index as sequences do, and what is taken is what a batch of those items alone holds."""

import numpy as np
import pytest
import torch
from determinism import same_bits
from hypothesis import given
from hypothesis import strategies as st
from made import BATCHES, batch_of
from problems import room_pair
from refusals import refuses
from torch import Tensor

import torchreg as tr

every_batch = pytest.mark.parametrize("kind", BATCHES, ids=lambda kind: kind.__name__)
COUNT = 4
MANY = {kind: batch_of(kind, COUNT) for kind in BATCHES}


def of(kind, numbers):
    """The batch of these items, made of them alone."""
    items = [BATCHES[kind](number) for number in numbers]
    return kind.pack(items) if items else None


@every_batch
def test_pack_undoes_iteration(kind):
    batch = MANY[kind]
    parts = list(batch)
    assert len(parts) == len(batch) == COUNT
    assert all(type(part) is kind and len(part) == 1 for part in parts)
    assert same_bits(kind.pack(parts), batch)
    assert all(same_bits(part, BATCHES[kind](number)) for number, part in enumerate(parts))


@every_batch
@given(numbers=st.lists(st.integers(-COUNT, COUNT - 1), min_size=1, max_size=6))
def test_numbers_take_items_in_any_order_and_again(kind, numbers):
    expected = of(kind, [number % COUNT for number in numbers])
    assert same_bits(MANY[kind][numbers], expected)
    assert same_bits(MANY[kind][torch.tensor(numbers)], expected)
    assert same_bits(MANY[kind][np.array(numbers)], expected)


@every_batch
@given(number=st.integers(-COUNT, COUNT - 1))
def test_a_number_takes_a_batch_of_one(kind, number):
    expected = of(kind, [number % COUNT])
    for key in (number, torch.tensor(number), np.int64(number), [number]):
        assert same_bits(MANY[kind][key], expected)


@every_batch
@given(key=st.slices(COUNT))
def test_a_slice_takes_what_a_list_would_give(kind, key):
    numbers = list(range(COUNT))[key]
    taken = MANY[kind][key]
    assert len(taken) == len(numbers)
    assert same_bits(taken, of(kind, numbers)) if numbers else list(taken) == []


@every_batch
@given(mask=st.lists(st.booleans(), min_size=COUNT, max_size=COUNT))
def test_a_mask_takes_what_it_marks(kind, mask):
    numbers = [number for number, one in enumerate(mask) if one]
    for key in (torch.tensor(mask), np.array(mask), mask):
        assert same_bits(MANY[kind][key], MANY[kind][numbers])


@every_batch
def test_what_is_no_index_is_refused(kind):
    noun = kind.noun
    for key in (COUNT, -COUNT - 1, [0, COUNT], torch.tensor([COUNT])):
        with pytest.raises(IndexError, match=rf"^index: expected a number from -4 to 3, for 4 {noun}, got -?\d"):
            MANY[kind][key]
    with pytest.raises(IndexError, match=rf"^index: expected a mask of 4 {noun}, got one of 2"):
        MANY[kind][[True, False]]
    for key in ("points", 1.0, None, True, (0, "a"), torch.tensor([0.5])):
        with pytest.raises(TypeError, match=f"^index: expected a number, a slice, numbers or a mask of {noun}, got"):
            MANY[kind][key]


@every_batch
def test_nothing_to_pack_is_refused(kind):
    with refuses(kind.noun, "at least one", "[]"):
        kind.pack([])


def test_items_that_follow_each_other_are_views():
    clouds = MANY[tr.Clouds]
    for key in (1, slice(1, 3), [1, 2]):
        assert clouds[key].points.data_ptr() == clouds.points[clouds.offsets[1] :].data_ptr()
        assert clouds[key].origin.data_ptr() == clouds.origin[1:].data_ptr()


def test_packed_batches_have_memory_of_their_own():
    one = BATCHES[tr.Clouds](0)
    packed = tr.Clouds.pack([one])
    assert packed.points.data_ptr() != one.points.data_ptr()
    assert same_bits(packed, one)


def test_features_of_other_blocks_are_not_joined():
    one = BATCHES[tr.Features](0)
    other = tr.Features(one.values, one.offsets, (("fpfh", 5),), one.valid)
    with refuses("blocks", "the same in all", "pcfh"):
        tr.Features.pack([one, other])


def test_what_one_result_has_and_another_has_not_is_refused():
    whole = BATCHES[tr.RegistrationResult](0)
    with refuses("strength", "for all 2 pairs or for none", "1 with and 1 without"):
        tr.RegistrationResult.pack([whole, type(whole)(**{**vars(whole), "strength": None})])


def test_matches_of_a_result_are_rows_of_its_own_clouds():
    results = MANY[tr.RegistrationResult][[2, 0, 2]]
    matches = results.correspondences
    for b, (begin, end) in enumerate(zip(matches.offsets[:-1], matches.offsets[1:], strict=True)):
        for rows, clouds in ((matches.source, results.source), (matches.target, results.target)):
            assert bool((rows[begin:end] >= clouds.offsets[b]).all() & (rows[begin:end] < clouds.offsets[b + 1]).all())


def test_a_result_of_one_pair_is_that_of_the_pair_alone():
    pairs = [room_pair(400, seed=seed) for seed in range(3)]
    options = tr.options_for(0.2)
    whole = tr.register(
        *(tr.Clouds.pack([getattr(pair, side) for pair in pairs]) for side in ("source", "target")), options
    )
    for pair, one in zip(pairs, whole, strict=True):
        assert same_bits(one, tr.register(pair.source, pair.target, options), ignore=("seconds",))
    assert isinstance(whole[whole.success].T_target_source, Tensor)
