"""Nearest features and mutual matches by compiled kernels: those of the functions in torch, bit for bit."""

import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import features

import torchreg as tr
from torchreg.matching.shadows import nearest_rows, shadowed
from torchreg.native import native_kernels, native_library

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")


def rows_of(kind, count, width, seed, dtype):
    """Features of one kind: some in few directions, some in all, some the same or nearly so many times over."""
    generator = torch.Generator().manual_seed(seed)
    shared = torch.Generator().manual_seed(width)
    noise = torch.randn(count, width, generator=generator, dtype=torch.float64)
    spectrum = 0.7 ** torch.arange(width, dtype=torch.float64)
    book = torch.rand(7, width, generator=shared, dtype=torch.float64)
    pick = torch.randint(7, (count,), generator=generator)
    values = {
        "spread": noise,
        "few directions": noise * spectrum,
        "far away": 1000 + noise * spectrum,
        "copies": book[pick],
        "crowd": torch.where(noise[:, :1] > -1, book[:1] + 1e-6 * noise, noise),
        "whole numbers": noise.round(),
        "nothing": torch.zeros_like(noise),
    }
    return values[kind].to(dtype)


KINDS = ["spread", "few directions", "far away", "copies", "crowd", "whole numbers", "nothing"]


def both_ways(function):
    with native_kernels(False):
        expected = function()
    return expected, function()


def assert_same(expected, found):
    assert all(same_bits(one, other) for one, other in zip(expected, found, strict=True))


@settings(max_examples=150)
@given(
    st.sampled_from(KINDS),
    st.integers(0, 2**31),
    st.integers(1, 60),
    st.integers(1, 200),
    st.integers(1, 50),
    st.integers(1, 6),
    st.booleans(),
    st.sampled_from([1e-9, 1.0, 1e9]),
)
def test_the_nearest_rows_are_those_of_torch(kind, seed, queries, rows, width, count, wide, scale):
    dtype = torch.float64 if wide else torch.float32
    query = scale * rows_of(kind, queries, width, seed, dtype)
    table = scale * rows_of(kind, rows, width, seed + 1, dtype)
    assert_same(*both_ways(lambda: nearest_rows(query, table, count)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [1, 3, 40])
def test_neither_threads_nor_large_tables_change_a_bit(kind, count):
    query, table = rows_of(kind, 300, 40, 1, torch.float32), rows_of(kind, 7000, 40, 2, torch.float32)
    with native_kernels(False):
        expected = nearest_rows(query, table, count)
    for number in THREADS:
        with threads(number):
            assert_same(expected, nearest_rows(query, table, count))


@settings(max_examples=100)
@given(
    st.sampled_from(KINDS),
    st.integers(0, 2**31),
    st.integers(1, 60),
    st.integers(1, 60),
    st.sampled_from([(None, 1), (None, 2), (None, 5), (0.9, 1), (1.0, 1)]),
    st.booleans(),
)
def test_mutual_matches_are_those_of_torch(kind, seed, sources, targets, how, wide):
    dtype = torch.float64 if wide else torch.float32
    source, target = (features(rows_of(kind, n, 20, seed + n, dtype)) for n in (sources, targets))
    ratio, neighbors = how

    def match():
        matches = tr.match_mutual(source, target, ratio=ratio, neighbors=neighbors)
        return matches.source, matches.target, matches.score

    assert_same(*both_ways(match))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_two_shadows_lie_farther_apart_than_their_rows(kind, dtype):
    source, target = rows_of(kind, 50, 30, 3, dtype), rows_of(kind, 400, 30, 4, dtype)
    both = shadowed(source, target)
    apart = torch.cdist(both.source.shadow.double(), both.target.shadow.double()).square()
    true = torch.cdist(source.double() / both.scale, target.double() / both.scale)
    allowed = both.unit * (both.source.norm[:, None] + both.target.norm).square() + both.tiny
    assert (apart <= true.square() + allowed).all()
    assert both.source.norm.amax() <= 1


def test_features_of_few_directions_get_short_shadows():
    rows = rows_of("few directions", 500, 64, 5, torch.float32)
    assert shadowed(rows, rows).source.shadow.shape[1] == 9


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e38])
def test_features_that_are_not_finite_or_huge_bring_no_row_out_of_range(bad):
    query, table = rows_of("spread", 20, 12, 6, torch.float32), rows_of("spread", 90, 12, 7, torch.float32)
    query[3, 4], table[5, 6] = bad, bad
    row, _ = nearest_rows(query, table, 2)
    assert ((row >= 0) & (row < 90)).all()
