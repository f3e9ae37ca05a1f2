"""The k-d tree finds what comparing all pairs finds, ties by row, below any limit."""

import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st

import torchreg as tr
from torchreg.native import native_kernels, native_library
from torchreg.neighborhoods.distances import sort_rows, sum_of_squares
from torchreg.neighborhoods.kd_tree import KdTree, fits_tree

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiled kernels")


def by_all_pairs(query, points, count, limit):
    squares = sum_of_squares(*(a[:, None] - b for a, b in zip(query.unbind(1), points.unbind(1), strict=True)))
    rows = torch.arange(len(points)).expand_as(squares)
    squares, rows = sort_rows(squares, rows)
    missing = torch.full((len(query), max(0, count - len(points))), torch.inf, dtype=query.dtype)
    squares, rows = torch.cat([squares, missing], 1)[:, :count], torch.cat([rows, missing.long()], 1)[:, :count]
    near = squares < limit
    return rows.where(near, -1), squares.where(near, torch.inf)


@settings(max_examples=60)
@given(
    queries=st.integers(0, 40),
    points=st.integers(1, 400),
    count=st.integers(1, 64),
    limit=st.sampled_from([0.0, 1e-4, 0.02, 0.5, torch.inf]),
    lattice=st.booleans(),
    dtype=st.sampled_from([torch.float32, torch.float64]),
    seed=st.integers(0, 2**31),
)
def test_it_finds_what_all_pairs_find(queries, points, count, limit, lattice, dtype, seed):
    generator = torch.Generator().manual_seed(seed)
    query, table = (torch.rand(many, 3, generator=generator, dtype=dtype) for many in (queries, points))
    if lattice:  # equal distances everywhere, and duplicates
        query, table = (query * 3).round() / 4, (table * 3).round() / 4
    found = KdTree(table).nearest(query, count, limit)
    assert same_bits(found, by_all_pairs(query, table, count, limit))


def test_the_number_of_threads_does_not_show():
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(30_000, 3, generator=generator).round(decimals=2)
    query = torch.rand(3000, 3, generator=generator)
    once = KdTree(points).nearest(query, 5)
    for number in THREADS:
        with threads(number):
            assert same_bits(KdTree(points).nearest(query, 5), once), f"{number} threads"


def test_what_no_tree_fits():
    assert fits_tree(torch.zeros(1, 3))
    assert not fits_tree(torch.zeros(0, 3))
    assert not fits_tree(torch.zeros(4, 3, dtype=torch.float16))
    assert not fits_tree(torch.zeros(4, 3, device="meta"))
    with native_kernels(False):
        assert not fits_tree(torch.zeros(4, 3))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("radius", [1e-30, 1e-19, 1e-12])
@pytest.mark.parametrize("number", [3, 60])
def test_duplicates_are_found_within_any_radius(dtype, radius, number):
    points = torch.rand(number, 3, generator=torch.Generator().manual_seed(0), dtype=dtype).repeat(2, 1)
    cloud = tr.Clouds(points=points)
    found, expected = (tr.neighbors(cloud, radius, 5, backend=name) for name in ("native", "torch"))
    assert same_bits((found.index, found.valid), (expected.index, expected.valid))
