"""Clouds check what they hold, and packing loses nothing."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from hypothesis import given
from hypothesis import strategies as st
from refusals import refuses
from torch.utils.data import DataLoader

import torchreg as tr

POINTS = torch.arange(15.0).reshape(5, 3)


def cloud(rows, seed=0, *, colors=True, normals=True, viewpoint=True, assumed=False, dtype=torch.float32):
    generator = torch.Generator().manual_seed(seed)

    def numbers(*shape, dtype=dtype):
        return torch.rand(*shape, generator=generator, dtype=dtype)

    return tr.Clouds(
        points=numbers(rows, 3),
        colors=numbers(rows, 3) if colors else None,
        normals=numbers(rows, 3) if normals else None,
        origin=numbers(1, 3, dtype=torch.float64),
        viewpoint=numbers(1, 3) if viewpoint else None,
        viewpoint_assumed=torch.tensor([assumed]),
    )


def test_defaults_make_one_cloud_at_the_origin():
    one = tr.Clouds(points=POINTS)
    assert len(one) == 1
    assert one.lengths == [5]
    assert one.offsets.tolist() == [0, 5]
    assert one.origin.dtype == torch.float64
    assert one.origin.tolist() == [[0, 0, 0]]
    assert one.colors is None
    assert one.normals is None
    assert one.viewpoint is None
    assert one.viewpoint_assumed.tolist() == one.viewpoint_known.tolist() == [False]


def test_clouds_are_frozen():
    one = tr.Clouds(points=POINTS)
    with pytest.raises(AttributeError):
        one.points = POINTS + 1


@pytest.mark.parametrize(
    ("fields", "name", "parts"),
    [
        ({"points": torch.zeros(100, 4)}, "points", ["(P, 3)", "(100, 4)"]),
        ({"points": torch.zeros(3)}, "points", ["(P, 3)", "(3,)"]),
        ({"points": torch.zeros(5, 3, dtype=torch.int64)}, "points", ["floating", "int64"]),
        ({"points": torch.zeros(5, 3, dtype=torch.complex64)}, "points", ["floating", "complex64"]),
        ({"points": [[0.0, 0.0, 0.0]]}, "points", ["tensor", "list"]),
        ({"offsets": torch.tensor([0, 4])}, "offsets", ["0 to 5", "[0, 4]"]),
        ({"offsets": torch.tensor([1, 5])}, "offsets", ["0 to 5", "[1, 5]"]),
        ({"offsets": torch.tensor([0, 4, 2, 5])}, "offsets", ["ascending", "[0, 4, 2, 5]"]),
        ({"offsets": torch.tensor([0, 5], dtype=torch.int32)}, "offsets", ["int64", "int32"]),
        ({"offsets": torch.tensor([[0, 5]])}, "offsets", ["(B+1,)", "(1, 2)"]),
        ({"offsets": torch.zeros(0, dtype=torch.int64)}, "offsets", ["0 to 5", "[]"]),
        ({"colors": torch.zeros(4, 3)}, "colors", ["(5, 3)", "(4, 3)"]),
        ({"colors": torch.zeros(5, 4)}, "colors", ["(5, 3)", "(5, 4)"]),
        ({"colors": torch.zeros(5, 3, dtype=torch.uint8)}, "colors", ["float32", "uint8"]),
        ({"colors": torch.zeros(5, 3, dtype=torch.float64)}, "colors", ["float32", "float64"]),
        ({"colors": torch.zeros(5, 3, device="meta")}, "colors", ["cpu", "meta"]),
        ({"normals": torch.zeros(5, 2)}, "normals", ["(5, 3)", "(5, 2)"]),
        ({"normals": torch.zeros(5, 3, dtype=torch.float64)}, "normals", ["float32", "float64"]),
        ({"normals": torch.zeros(5, 3, device="meta")}, "normals", ["cpu", "meta"]),
        ({"origin": torch.zeros(1, 3)}, "origin", ["float64", "float32"]),
        ({"origin": torch.zeros(3, dtype=torch.float64)}, "origin", ["(1, 3)", "(3,)"]),
        ({"origin": torch.zeros(2, 3, dtype=torch.float64)}, "origin", ["(1, 3)", "(2, 3)"]),
        ({"origin": torch.zeros(1, 3, dtype=torch.float64, device="meta")}, "origin", ["cpu", "meta"]),
        ({"viewpoint": torch.zeros(3)}, "viewpoint", ["(1, 3)", "(3,)"]),
        ({"viewpoint": torch.zeros(1, 3, dtype=torch.int64)}, "viewpoint", ["floating", "int64"]),
        ({"viewpoint": torch.zeros(1, 3, device="meta")}, "viewpoint", ["cpu", "meta"]),
        ({"viewpoint_assumed": torch.tensor(True)}, "viewpoint_assumed", ["(1,)", "()"]),
        ({"viewpoint_assumed": torch.tensor([True, False])}, "viewpoint_assumed", ["(1,)", "(2,)"]),
        ({"viewpoint_assumed": torch.zeros(1)}, "viewpoint_assumed", ["bool", "float32"]),
        ({"viewpoint_assumed": [True]}, "viewpoint_assumed", ["tensor", "list"]),
        ({"viewpoint_assumed": torch.ones(1, dtype=torch.bool, device="meta")}, "viewpoint_assumed", ["cpu", "meta"]),
    ],
)
def test_what_does_not_fit_is_refused(fields, name, parts):
    with refuses(name, *parts):
        tr.Clouds(**({"points": POINTS} | fields))


@given(
    st.lists(st.tuples(st.integers(0, 6), st.booleans()), min_size=1, max_size=6),
    *(st.booleans(), st.booleans(), st.booleans(), st.booleans()),
)
def test_unpack_undoes_pack(sizes, colors, normals, viewpoint, wide):
    dtype = torch.float64 if wide else torch.float32
    made = [
        cloud(rows, seed, colors=colors, normals=normals, viewpoint=viewpoint, assumed=assumed, dtype=dtype)
        for seed, (rows, assumed) in enumerate(sizes)
    ]
    lengths = [rows for rows, _ in sizes]
    packed = tr.Clouds.pack(made)
    assert packed.lengths == lengths
    assert all(same_bits(one, other) for one, other in zip(made, packed.unpack(), strict=True))
    assert same_bits(tr.Clouds.pack(packed.unpack()), packed)


@given(st.lists(st.integers(0, 4), min_size=1, max_size=5), st.integers(0, 4))
def test_pack_takes_batches_too(lengths, cut):
    made = [cloud(rows, seed) for seed, rows in enumerate(lengths)]
    cut = min(cut, len(made))
    batches = [tr.Clouds.pack(part) for part in (made[:cut], made[cut:]) if part]
    assert same_bits(tr.Clouds.pack(batches), tr.Clouds.pack(made))


def test_unknown_viewpoints_beside_known_ones_become_nan():
    packed = tr.Clouds.pack([cloud(2, 0, viewpoint=False), cloud(3, 1)])
    assert torch.isnan(packed.viewpoint[0]).all()
    assert torch.isfinite(packed.viewpoint[1]).all()


KINDS = {  # of viewpoint -> whether it is (assumed, known)
    "none": (False, False),
    "nan": (False, False),
    "assumed": (True, False),
    "known": (False, True),
}


def of_kind(kind, seed=0):
    one = cloud(3, seed, viewpoint=kind != "none", assumed=kind == "assumed")
    return replace(one, viewpoint=one.viewpoint * float("nan")) if kind == "nan" else one


def flags(clouds):
    return list(zip(clouds.viewpoint_assumed.tolist(), clouds.viewpoint_known.tolist(), strict=True))


@given(st.lists(st.sampled_from(sorted(KINDS)), min_size=1, max_size=5), st.randoms(use_true_random=False))
def test_a_viewpoint_is_known_assumed_or_not_there_whatever_clouds_go_through(kinds, random):
    packed = tr.Clouds.pack([of_kind(kind, seed) for seed, kind in enumerate(kinds)])
    expected = [KINDS[kind] for kind in kinds]
    assert flags(packed) == expected
    assert [flags(one)[0] for one in packed.unpack()] == expected
    order = random.choices(range(len(kinds)), k=4)
    assert flags(packed.select(order)) == [expected[b] for b in order]
    kept = packed.rows(torch.arange(len(kinds)) * 3, torch.arange(len(kinds) + 1))
    for same in (kept, packed.detach(), packed.to(dtype=torch.float64), packed.to("cpu", torch.float16)):
        assert flags(same) == expected
        assert same.viewpoint_assumed.dtype == torch.bool


@pytest.mark.parametrize("kind", KINDS)
def test_without_a_viewpoint_nothing_is_assumed(kind):
    one = of_kind(kind)
    for nothing in (None, torch.full((1, 3), float("nan")), torch.tensor([[0.0, float("inf"), 0.0]])):
        assert flags(replace(one, viewpoint=nothing)) == [(False, False)]
        assert flags(tr.Clouds(POINTS, viewpoint=nothing, viewpoint_assumed=torch.tensor([True]))) == [(False, False)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_viewpoint_given_where_there_was_none_is_known_and_a_moved_guess_stays_a_guess(kind):
    place = torch.tensor([[1.0, 2.0, 3.0]])
    one = of_kind(kind)
    was_assumed = kind == "assumed"
    assert flags(replace(one, viewpoint=place)) == [(was_assumed, not was_assumed)]
    assert flags(replace(replace(one, viewpoint=None), viewpoint=place)) == [(False, True)]
    assert flags(replace(one, viewpoint=place, viewpoint_assumed=None)) == [(False, True)]
    assert flags(replace(one, viewpoint=place, viewpoint_assumed=torch.tensor([True]))) == [(True, False)]


@pytest.mark.parametrize("name", ["colors", "normals"])
def test_colors_and_normals_are_for_all_or_for_none(name):
    with refuses(name, "all 2 clouds", "1 with and 1 without"):
        tr.Clouds.pack([cloud(2), cloud(2, **{name: False})])


def test_nothing_to_pack_is_refused():
    with refuses("clouds", "[]"):
        tr.Clouds.pack([])


def test_select_names_clouds_in_any_order_and_again():
    made = [cloud(rows, seed) for seed, rows in enumerate((2, 0, 3))]
    packed = tr.Clouds.pack(made)
    assert same_bits(packed.select([2, 0, 2]), tr.Clouds.pack([made[2], made[0], made[2]]))
    assert same_bits(packed.select(1), made[1])
    assert same_bits(packed.select(-1), made[2])
    with pytest.raises(IndexError):
        packed.select(3)


def test_rows_takes_points_colors_and_normals_together():
    one = cloud(5)
    index = torch.tensor([4, 0, 0])
    taken = one.rows(index, torch.tensor([0, 3]))
    for name in ("points", "colors", "normals"):
        assert torch.equal(getattr(taken, name), getattr(one, name)[index])
    assert same_bits(taken.origin, one.origin)


def test_to_changes_the_dtype_of_all_but_the_origin():
    wide = cloud(3).to(dtype=torch.float64)
    for name in ("points", "colors", "normals", "viewpoint", "origin"):
        assert getattr(wide, name).dtype == torch.float64
    narrow = wide.to(dtype=torch.float32)
    assert narrow.points.dtype == torch.float32
    assert narrow.origin.dtype == torch.float64
    assert same_bits(narrow, cloud(3))


def test_to_moves_everything_but_the_offsets():
    moved = cloud(3).to("meta")
    tensors = (moved.points, moved.colors, moved.origin, moved.viewpoint_assumed, moved.viewpoint_known)
    assert {tensor.device.type for tensor in tensors} == {"meta"}
    assert moved.offsets.device.type == "cpu"
    assert moved.device.type == "meta"


def test_pack_is_a_collate_function():
    made = [cloud(rows, seed) for seed, rows in enumerate((4, 0, 2, 3, 5))]
    batches = list(DataLoader(made, batch_size=2, collate_fn=tr.Clouds.pack))
    assert [batch.lengths for batch in batches] == [[4, 0], [2, 3], [5]]
    assert same_bits(tr.Clouds.pack(batches), tr.Clouds.pack(made))


@pytest.mark.slow
def test_pack_is_a_collate_function_of_workers():
    made = [cloud(rows, seed) for seed, rows in enumerate((4, 1, 2, 3))]
    loader = DataLoader(made, batch_size=2, collate_fn=tr.Clouds.pack, num_workers=2, multiprocessing_context="spawn")
    assert same_bits(tr.Clouds.pack(list(loader)), tr.Clouds.pack(made))
