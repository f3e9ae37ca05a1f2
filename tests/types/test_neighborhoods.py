"""Neighborhoods check their shapes, and a narrower one is what a narrower search finds."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import room_pair
from refusals import refuses

import torchreg as tr

FIELDS = {
    "index": torch.zeros(4, 2, dtype=torch.int64),
    "valid": torch.ones(4, 2, dtype=torch.bool),
    "sq_distance": torch.zeros(4, 2),
}


@pytest.mark.parametrize(
    ("fields", "name", "parts"),
    [
        ({"index": torch.zeros(4, dtype=torch.int64)}, "index", ["(P, K)", "(4,)"]),
        ({"index": torch.zeros(4, 2, dtype=torch.int32)}, "index", ["int64", "int32"]),
        ({"valid": torch.ones(4, 3, dtype=torch.bool)}, "valid", ["(4, 2)", "(4, 3)"]),
        ({"valid": torch.ones(4, 2)}, "valid", ["bool", "float32"]),
        ({"valid": torch.ones(4, 2, dtype=torch.bool, device="meta")}, "valid", ["cpu", "meta"]),
        ({"sq_distance": torch.zeros(3, 2)}, "sq_distance", ["(4, 2)", "(3, 2)"]),
        ({"sq_distance": torch.zeros(4, 2, dtype=torch.int64)}, "sq_distance", ["floating", "int64"]),
        ({"sq_distance": torch.zeros(4, 2, device="meta")}, "sq_distance", ["cpu", "meta"]),
        ({"radius": 0.0}, "radius", ["above 0", "0.0"]),
        ({"radius": torch.ones(3)}, "radius", ["(4,)", "(3,)"]),
    ],
)
def test_what_does_not_fit_is_refused(fields, name, parts):
    with refuses(name, *parts):
        tr.Neighborhoods(**(FIELDS | fields))


def test_sizes():
    near = tr.Neighborhoods(**(FIELDS | {"valid": torch.tensor([[True, False]] * 4)}))
    assert len(near) == 4
    assert near.max_neighbors == 2
    assert near.counts().tolist() == [1, 1, 1, 1]


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.floats(0.05, 1.0), st.floats(0.05, 1.0), st.integers(1, 40))
def test_restrict_finds_what_a_narrower_search_finds(seed, wide, share, slots):
    cloud = tr.Clouds(points=torch.rand(40, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64))
    narrow = wide * share
    near = tr.neighbors(cloud, wide, 40).restrict(narrow, slots)
    searched = tr.neighbors(cloud, narrow, slots)
    assert torch.equal(near.valid, searched.valid)
    assert torch.equal(near.index[near.valid], searched.index[near.valid])
    assert torch.equal(near.sq_distance[near.valid], searched.sq_distance[near.valid])
    assert ((near.index >= 0) & (near.index < 40)).all()
    assert torch.isfinite(near.sq_distance).all()


def test_slots_that_restrict_empties_stay_legal_and_finite():
    cloud = tr.Clouds(points=torch.rand(30, 3, generator=torch.Generator().manual_seed(0)))
    near = tr.neighbors(cloud, 1.0, 30).restrict(0.3)
    empty = ~near.valid
    assert empty.any()
    assert torch.isfinite(near.sq_distance[empty]).all()
    assert ((near.index[empty] >= 0) & (near.index[empty] < 30)).all()


def test_restrict_takes_a_radius_per_point():
    cloud = tr.Clouds(points=torch.rand(30, 3, generator=torch.Generator().manual_seed(1)))
    near = tr.neighbors(cloud, 1.0, 30)
    radius = torch.where(torch.arange(30) % 2 == 0, 0.2, 0.5).double()
    mixed, short, long = near.restrict(radius), near.restrict(0.2), near.restrict(0.5)
    assert torch.equal(mixed.valid[::2], short.valid[::2])
    assert torch.equal(mixed.valid[1::2], long.valid[1::2])


def test_neighborhoods_know_the_radius_within_which_they_lie():
    cloud = tr.Clouds(points=torch.rand(30, 3, generator=torch.Generator().manual_seed(2)))
    near = tr.neighbors(cloud, 0.5, 30)
    assert near.radius == 0.5
    assert near.trimmed().radius == near.restrict(max_neighbors=3).radius == 0.5
    assert near.restrict(0.2).radius == near.restrict(0.2).restrict(0.9).radius == 0.2
    assert tr.Neighborhoods(**FIELDS).radius is None
    assert tr.Neighborhoods(**FIELDS).restrict(0.3).radius == 0.3


def test_a_batch_knows_the_radius_of_every_point():
    cloud = tr.Clouds(points=torch.rand(5, 3), offsets=torch.tensor([0, 2, 5]))
    assert tr.neighbors(cloud, torch.tensor([0.5, 0.5]), 3).radius == 0.5
    near = tr.neighbors(cloud, torch.tensor([0.5, 0.25]), 3)
    assert near.radius.tolist() == [0.5, 0.5, 0.25, 0.25, 0.25]
    assert near.restrict(0.375).radius.tolist() == [0.375, 0.375, 0.25, 0.25, 0.25]
    narrow = torch.tensor([0.125, 1, 1, 1, 0.125])
    assert near.restrict(narrow).radius.tolist() == [0.125, 0.5, 0.25, 0.25, 0.125]
    assert tr.neighbors(cloud, 0.375, 3).restrict(narrow).radius.tolist() == [0.125, 0.375, 0.375, 0.375, 0.125]


def test_a_neighbor_at_the_radius_is_out():
    cloud = tr.Clouds(points=torch.tensor([[0.0, 0, 0], [2, 0, 0], [1, 0, 0]]))
    near = tr.neighbors(cloud, 5.0, 3).restrict(2.0)
    assert near.counts().tolist() == [2, 2, 3]


@pytest.mark.parametrize("radius", [0, -1.0, float("nan"), float("inf"), True, "1"])
def test_a_radius_that_is_none_is_refused(radius):
    with refuses("radius", "above 0"):
        tr.Neighborhoods(**FIELDS).restrict(radius)


def test_restrict_refuses_what_does_not_fit():
    near = tr.Neighborhoods(**FIELDS)
    with refuses("radius", "(4,)", "(3,)"):
        near.restrict(torch.ones(3))
    with refuses("max_neighbors", "at least 1", "0"):
        near.restrict(max_neighbors=0)


def test_trimming_keeps_every_neighbor_and_no_empty_column():
    scan = room_pair(300).source
    near = tr.neighbors(scan, 0.6, 80)
    trimmed = near.trimmed()
    assert trimmed.max_neighbors == int(near.counts().max()) < 80
    assert torch.equal(trimmed.counts(), near.counts())
    assert torch.equal(tr.pcfh(scan, trimmed).values, tr.pcfh(scan, near).values)


def test_an_empty_neighborhood_keeps_one_slot():
    empty = tr.neighbors(tr.Clouds(points=torch.zeros(0, 3)), 1.0, 5)
    assert empty.trimmed().max_neighbors == 1


def test_the_neighborhoods_of_one_cloud_of_a_batch_are_those_of_the_cloud_alone():
    batch = tr.Clouds.from_list([torch.rand(7, 3), torch.rand(5, 3)])
    near = tr.neighbors(batch, 0.5, 4)
    for b, (begin, end) in enumerate(zip(batch.offsets[:-1].tolist(), batch.offsets[1:].tolist(), strict=True)):
        one, alone = near.of_rows(begin, end), tr.neighbors(batch[b], 0.5, 4)
        assert torch.equal(one.valid, alone.valid)
        assert torch.equal(one.index[one.valid], alone.index[alone.valid])
