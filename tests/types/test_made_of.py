"""Clouds of lists and of padded tensors, and back."""

import numpy as np
import pytest
import torch
from determinism import same_bits
from hypothesis import given
from hypothesis import strategies as st
from problems import seeded
from refusals import refuses

import torchreg as tr


def rows(lengths, seed):
    generator = seeded(seed)
    return [torch.rand(length, 3, generator=generator) for length in lengths]


sizes = st.lists(st.integers(0, 6), min_size=1, max_size=5)


def optional(there, lengths, seed):
    return rows(lengths, seed) if there else None


@given(sizes, st.booleans(), st.booleans())
def test_a_list_makes_the_clouds_that_each_makes_alone(lengths, colors, normals):
    points, *others = rows(lengths, 0), optional(colors, lengths, 1), optional(normals, lengths, 2)
    clouds = tr.Clouds.from_list(points, *others)
    assert clouds.lengths == lengths
    alone = [tr.Clouds(one, None, *(other and other[b] for other in others)) for b, one in enumerate(points)]
    assert same_bits(clouds, tr.Clouds.pack(alone))


@given(sizes, st.booleans(), st.booleans(), st.booleans())
def test_from_padded_undoes_to_padded(lengths, colors, normals, wide):
    clouds = tr.Clouds.from_list(rows(lengths, 0), optional(colors, lengths, 1), optional(normals, lengths, 2))
    clouds = clouds.to(torch.float64 if wide else torch.float32)
    padded = clouds.to_padded()
    assert padded.points.shape == (len(lengths), max(lengths), 3)
    assert padded.lengths.tolist() == padded.mask.sum(dim=1).tolist() == lengths
    assert not padded.points[~padded.mask].any()
    assert same_bits(tr.Clouds.from_padded(*padded), clouds)


@given(sizes)
def test_what_lies_behind_the_last_row_changes_nothing(lengths):
    padded = tr.Clouds.from_list(rows(lengths, 0), rows(lengths, 1)).to_padded()
    dirty = torch.where(padded.mask[..., None], padded.points, torch.nan)
    wider = torch.cat([dirty, torch.full((len(lengths), 2, 3), torch.inf)], dim=1)
    for points in (dirty, wider):
        for form in (padded.lengths, lengths, tuple(lengths)):
            assert same_bits(tr.Clouds.from_padded(points, form), tr.Clouds.from_list(rows(lengths, 0)))


def test_gradients_flow_there_and_back():
    padded = torch.rand(2, 5, 3, requires_grad=True)
    lengths = torch.tensor([5, 2])
    tr.Clouds.from_padded(padded, lengths).to_padded().points.sum().backward()
    expected = torch.arange(5) < lengths[:, None]
    assert torch.equal(padded.grad, expected[..., None].expand(2, 5, 3).float())


def test_no_cloud_at_all_is_padded_to_nothing():
    clouds = tr.Clouds(torch.rand(5, 3))[:0]
    assert clouds.to_padded().points.shape == (0, 0, 3)
    assert len(tr.Clouds.from_padded(*clouds.to_padded())) == 0


TWO = [torch.zeros(2, 3), torch.zeros(4, 3)]


@pytest.mark.parametrize(
    ("arguments", "name", "parts"),
    [
        (([],), "points", ["at least one tensor (P, 3)"]),
        (([[0.0, 0.0, 0.0]],), "points[0]", ["a tensor (P, 3)", "list"]),
        (([TWO[0], torch.zeros(2, 2)],), "points[1]", ["(P, 3)", "(2, 2)"]),
        (([TWO[0], TWO[1].double()],), "points[1]", ["float32", "float64"]),
        (([TWO[0], TWO[1].to("meta")],), "points[1]", ["cpu", "meta"]),
        ((TWO, TWO[:1]), "colors", ["one tensor per cloud (2)", "1"]),
        ((TWO, TWO[::-1]), "colors[0]", ["(2, 3)", "(4, 3)"]),
        ((TWO, None, [TWO[0], TWO[1].byte()]), "normals[1]", ["float32", "uint8"]),
    ],
)
def test_lists_that_do_not_fit_are_refused(arguments, name, parts):
    with refuses(name, *parts):
        tr.Clouds.from_list(*arguments)


PADDED = torch.zeros(2, 4, 3)


@pytest.mark.parametrize(
    ("arguments", "name", "parts"),
    [
        ((PADDED[0], torch.tensor([4])), "points", ["(B, N, 3)", "(4, 3)"]),
        ((PADDED, torch.tensor([4])), "lengths", ["(2,)", "(1,)"]),
        ((PADDED, torch.tensor([4, 5])), "lengths", ["from 0 to 4", "[4, 5]"]),
        ((PADDED, torch.tensor([4, -1])), "lengths", ["from 0 to 4", "[4, -1]"]),
        ((PADDED, torch.tensor([4.0, 1.0])), "lengths", ["whole numbers", "float32"]),
        ((PADDED, [4, 1.0]), "lengths", ["whole numbers", "[4, 1.0]"]),
        ((PADDED, [True, False]), "lengths", ["whole numbers", "[True, False]"]),
        ((PADDED, "41"), "lengths", ["whole numbers", "'41'"]),
        ((PADDED, [4, 1, 2]), "lengths", ["(2,)", "(3,)"]),
        ((PADDED, [4, 5]), "lengths", ["from 0 to 4", "[4, 5]"]),
        ((PADDED, torch.tensor([4, 1]), PADDED[:, :3]), "colors", ["(2, 4, 3)", "(2, 3, 3)"]),
        ((PADDED, torch.tensor([4, 1]), None, PADDED.double()), "normals", ["float32", "float64"]),
    ],
)
def test_padded_tensors_that_do_not_fit_are_refused(arguments, name, parts):
    with refuses(name, *parts):
        tr.Clouds.from_padded(*arguments)


@pytest.mark.parametrize(
    ("points", "parts"),
    [
        (np.zeros((5, 3)), ["a tensor (P, 3)", "an array (5, 3) float64", "try torchreg.from_numpy(points)"]),
        (TWO, ["a tensor (P, 3)", "list", "try Clouds.from_list(points)"]),
        ("a.ply", ["a tensor (P, 3)", "'a.ply'", "try read_cloud(path)"]),
        (PADDED, ["(P, 3)", "(2, 4, 3)", "try Clouds.from_padded(points, lengths)"]),
    ],
)
def test_points_in_another_form_are_refused_with_what_takes_them(points, parts):
    with refuses("points", *parts):
        tr.Clouds(points)
