"""Whichever of its two searches Open3D uses, and in however many pieces, the result is the same."""

from importlib import import_module

import pytest
import torch
from determinism import same_bits
from problems import random_points

from torchreg.neighborhoods.distances import sort_rows
from torchreg.neighborhoods.open3d_search import Tree, mend_rows, search_open3d

MODULE = import_module("torchreg.neighborhoods.open3d_search")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("radius", [0.03, 0.1, 0.3])
def test_both_searches_find_the_same(monkeypatch, radius, dtype):
    points = random_points(1500, dtype=dtype)
    arguments = points, [(0, 1500)], [radius**2], 25
    chosen = search_open3d(*arguments)
    for share in (0.0, torch.inf):  # the nearest K, then all within the radius
        monkeypatch.setattr(MODULE, "HYBRID_UP_TO", share)
        assert same_bits(search_open3d(*arguments), chosen)


def test_the_search_is_chosen_by_how_many_lie_within_the_radius(monkeypatch):
    calls = []

    def spied(name, method):
        def spy(self, queries, *arguments):
            calls.append((name, len(queries)))
            return method(self, queries, *arguments)

        return spy

    for name in ("nearest", "nearest_within"):
        monkeypatch.setattr(Tree, name, spied(name, getattr(Tree, name)))
    points = random_points(2000)
    search_open3d(points, [(0, 2000)], [0.05**2], 30)
    assert calls[-1] == ("nearest_within", 2000)
    search_open3d(points, [(0, 2000)], [1.0], 30)
    assert calls[-1] == ("nearest", 2000)


def test_pieces_do_not_show(monkeypatch):
    points = random_points(700)
    arguments = points, [(0, 400), (400, 700)], [0.04, 1.0], 30
    whole = search_open3d(*arguments)
    for search_slots, chunk_slots in ((30 * 128, 1000), (1, 1)):
        monkeypatch.setattr(MODULE, "SEARCH_SLOTS", search_slots)
        monkeypatch.setattr(MODULE, "CHUNK_SLOTS", chunk_slots)
        assert same_bits(search_open3d(*arguments), whole)


def test_mending_sorts_what_is_not_ascending_below_the_limit():
    generator = torch.Generator().manual_seed(0)
    squares = torch.randint(0, 30, (400, 8), generator=generator).float().sort(dim=1).values
    squares[::7] = squares[::7].flip(1)
    index = torch.stack([torch.randperm(50, generator=generator)[:8] for _ in range(400)])
    mended, mended_index = squares.clone(), index.clone()
    mend_rows(mended, mended_index, 20.0)
    sorted_squares, sorted_index = sort_rows(squares, index)
    inside = sorted_squares < 20.0
    assert torch.equal(mended[inside], sorted_squares[inside])
    assert torch.equal(mended_index[inside], sorted_index[inside])
    assert torch.equal(mended < 20.0, inside)


def test_the_tree_takes_points_that_are_a_view():
    points = random_points(100)
    spread = points.repeat(1, 2)[:, :3]  # rows are not one after another in memory
    assert not spread.is_contiguous()
    found = Tree(spread).nearest(spread, 4)
    assert found.dtype == torch.int32
    assert torch.equal(found, Tree(points).nearest(points, 4))
    assert torch.equal(found[:, 0], torch.arange(100, dtype=torch.int32))
