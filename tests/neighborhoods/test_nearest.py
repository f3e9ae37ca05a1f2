"""The nearest of another set, exactly, by tree or by all pairs."""

import pytest
import torch
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_points
from refusals import refuses

from torchreg.native import native_kernels, native_library
from torchreg.neighborhoods import nearest
from torchreg.neighborhoods.point_index import PointIndex, nearest_of_all, several_nearest

every_backend = pytest.mark.parametrize("backend", ["open3d", "torch", *(["native"] if native_library() else [])])
both_dtypes = pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)


@every_backend
@both_dtypes
@settings(max_examples=25)
@given(queries=st.integers(0, 50), count=st.integers(1, 60), seed=st.integers(0, 2**31))
def test_it_finds_what_all_pairs_find(backend, dtype, queries, count, seed):
    query, points = random_points(queries, seed, dtype), random_points(count, seed + 1, dtype)
    found = nearest(query, points, backend=backend)
    x, y, z = (points - query[:, None]).unbind(2)
    squares = x * x + y * y + z * z
    assert same_bits(found.index, squares.argmin(dim=1))
    assert same_bits(found.sq_distance, squares.amin(dim=1))


@every_backend
def test_a_set_is_nearest_to_itself(backend):
    points = random_points(500)
    found = nearest(points, points, backend=backend)
    assert torch.equal(found.index, torch.arange(500))
    assert not found.sq_distance.any()


@every_backend
def test_without_points_there_is_none(backend):
    index, sq_distance = nearest(random_points(4), torch.zeros(0, 3), backend=backend)
    assert index.tolist() == [-1] * 4
    assert sq_distance.tolist() == [torch.inf] * 4
    assert nearest(torch.zeros(0, 3), random_points(4), backend=backend).index.shape == (0,)


@settings(max_examples=25)
@given(st.integers(1, 40), st.integers(1, 60), st.integers(1, 20), st.integers(0, 2**31))
def test_several_nearest_are_those_of_all_pairs(queries, count, several, seed):
    query, points = random_points(queries, seed, torch.float64), random_points(count, seed + 1, torch.float64)
    squares = (points - query[:, None]).square().sum(dim=2)
    expected = squares.argsort(dim=1)[:, :several]
    assert torch.equal(several_nearest(query, points, several), expected)
    assert torch.equal(nearest_of_all(query, points, several, 3000), expected)


@every_backend
@both_dtypes
@settings(max_examples=25)
@given(queries=st.integers(1, 50), count=st.integers(1, 300), cells=st.integers(0, 4), seed=st.integers(0, 2**31))
def test_of_equally_near_ones_it_takes_the_smallest_index(backend, dtype, queries, count, cells, seed):
    query, points = (
        (many * cells).round() / 2 for many in (random_points(queries, seed, dtype), random_points(count, 1, dtype))
    )
    square = (points - query[:, None]).square().sum(dim=2)
    first = (square == square.amin(dim=1, keepdim=True)).int().argmax(dim=1)
    assert torch.equal(nearest(query, points, backend=backend).index, first)
    with native_kernels(backend == "native"):
        assert torch.equal(PointIndex(points).nearest(query).index, first)


@pytest.mark.parametrize("max_bytes", [1, 5_000, 2**20])
def test_the_budget_of_memory_does_not_show(max_bytes):
    query, points = random_points(300), random_points(200, seed=1)
    found = nearest(query, points, backend="torch", max_bytes=max_bytes)
    assert same_bits(found, nearest(query, points, backend="torch"))


@every_backend
def test_it_carries_no_gradient(backend):
    found = nearest(random_points(5).requires_grad_(), random_points(9, seed=1).requires_grad_(), backend=backend)
    assert not found.sq_distance.requires_grad


@pytest.mark.parametrize(
    ("changes", "name", "parts"),
    [
        ({"query": torch.zeros(3)}, "query", ["(Q, 3)", "(3,)"]),
        ({"points": torch.zeros(3, 2)}, "points", ["(N, 3)", "(3, 2)"]),
        ({"query": torch.zeros(3, 3, dtype=torch.int64)}, "query", ["float32", "int64"]),
        ({"points": torch.zeros(3, 3, dtype=torch.float64)}, "points", ["float32", "float64"]),
        ({"points": torch.zeros(3, 3, device="meta")}, "points", ["cpu", "meta"]),
        ({"query": torch.full((2, 3), torch.nan)}, "query", ["finite", "2 points"]),
        ({"points": torch.full((3, 3), torch.inf)}, "points", ["finite", "3 points"]),
        ({"backend": "best"}, "backend", ["'auto'", "'best'"]),
    ],
)
def test_what_does_not_fit_is_refused(changes, name, parts):
    arguments = {"query": random_points(4), "points": random_points(5)} | changes
    with refuses(name, *parts):
        nearest(**arguments)
