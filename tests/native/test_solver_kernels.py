"""Compiled kernels of the solvers give the bits of torch, for any number of threads."""

import pytest
import torch
from determinism import same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import columns, pack_problems

import torchreg as tr
from torchreg.datasets import match_problem
from torchreg.native import native_kernels, native_library
from torchreg.solvers.compatibility import nodes
from torchreg.solvers.compatibility.graph import first_order
from torchreg.solvers.compatibility.sets import consensus_sets, fit_sets
from torchreg.solvers.local_optimization import optimize
from torchreg.solvers.points import PairPoints
from torchreg.solvers.poses import spread_out
from torchreg.solvers.scoring import by_count, by_msac, score

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")

DTYPES = (torch.float32, torch.float64)


def assert_same(run):
    """The same bits by torch and compiled, with one to three threads."""
    with native_kernels(False):
        expected = run()
    for number in (1, 2, 3):
        with threads(number):
            assert same_bits(run(), expected), f"{number} threads"


def points_of(count, seed, dtype=torch.float64):
    """Correspondences (3, M) twice, among them some that coincide, on one side or both."""
    generator = torch.Generator().manual_seed(seed)
    source = 3 * torch.randn(3, count, dtype=torch.float64, generator=generator)
    target = source + 0.1 * torch.randn(3, count, dtype=torch.float64, generator=generator)
    target[:, ::3] = 3 * torch.randn(3, len(range(0, count, 3)), dtype=torch.float64, generator=generator)
    source[:, 1::7] = source[:, :1]
    target[:, 1::14] = target[:, :1]
    return source.to(dtype), target.to(dtype)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 90), st.integers(0, 2**31), st.sampled_from(DTYPES), st.sampled_from([0.05, 0.3, 2.0]))
def test_graphs_and_their_sets(count, seed, dtype, threshold):
    points = points_of(count, seed, dtype)
    assert_same(lambda: first_order(*points, threshold))
    graph = first_order(*points, threshold)
    for wide, narrow in ((30, 20), (2, 3), (200, 98), (70, 66)):
        if count > 1:
            assert_same(lambda wide=wide, narrow=narrow: consensus_sets(graph, wide, narrow))


@pytest.mark.parametrize("density", [0.0, 0.02, 0.5, 1.0])
def test_sets_of_sparse_and_full_graphs(density):
    graph = (torch.rand(130, 130, generator=torch.Generator().manual_seed(0)) < density).float().triu(1)
    assert_same(lambda: consensus_sets(graph + graph.t(), 30, 20))


@pytest.mark.parametrize("sets", [0, 1, 700])
def test_fits_of_sets(sets):
    source, target = points_of(80, sets)
    generator = torch.Generator().manual_seed(1)
    members = torch.randint(80, (sets, 9), generator=generator)
    weights = torch.randint(0, 5, (sets, 9), generator=generator).double()
    weights[::5] = 0
    weights[1::5, 2:] = 0
    assert_same(lambda: fit_sets(source, target, members, weights))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("count", [1, 300, 2048, 4500])
def test_degrees_and_their_chance(count, dtype):
    points = points_of(count, count, dtype)
    others = tuple(side[:, : max(1, count // 3)] for side in points)
    assert_same(lambda: nodes.degrees(*points, 0.3))
    assert_same(lambda: nodes.degrees_among(points, others, 0.3))
    for width in (0.02, 0.1, 1.0):
        assert_same(lambda width=width: nodes._chance(points, others, width))


def test_the_choice_among_many_matches():
    points = columns(match_problem(3000, 0.97, place="room", noise=0.05), torch.float32)
    assert_same(lambda: nodes.choose_nodes(*points, 0.2, 300))


def pairs_beside(counts, seed=0):
    """Points of several pairs, zeros behind the last of each."""
    width = max(counts)
    sides = [points_of(count, seed + place) for place, count in enumerate(counts)]
    source, target = (
        torch.stack([torch.nn.functional.pad(side[k], (0, width - side[k].shape[1])) for side in sides], dim=1)
        for k in range(2)
    )
    valid = torch.arange(width) < torch.tensor(counts)[:, None]
    center = torch.zeros(len(counts), 3, dtype=torch.float64)
    thresholds = tuple(0.1 * (place + 1) for place in range(len(counts)))
    return PairPoints(source, target, valid, valid.double(), tuple(counts), thresholds, center, center, counts)


@pytest.mark.parametrize("quality", [by_count, by_msac])
@pytest.mark.parametrize("counts", [(500,), (3,), (1025, 40, 700)])
@pytest.mark.parametrize("hypotheses", [0, 1, 45])
def test_scores_and_refits(hypotheses, counts, quality):
    points = pairs_beside(counts)
    generator = torch.Generator().manual_seed(hypotheses)
    pair = torch.randint(len(counts), (hypotheses,), generator=generator).sort().values
    twist = 0.05 * torch.randn(hypotheses, 3, 3, dtype=torch.float64, generator=generator)
    rotation = torch.matrix_exp(twist - twist.transpose(1, 2)).permute(1, 2, 0)
    translation = 0.1 * torch.randn(3, hypotheses, dtype=torch.float64, generator=generator)
    if hypotheses > 1:
        translation[:, 0] = 1e6  # no inlier
    assert_same(lambda: tuple(score(rotation, translation, pair, points, quality)))
    start = score(rotation, translation, pair, points, quality)
    for rounds in (-1, 0, 1, 10):
        assert_same(lambda rounds=rounds: tuple(optimize(start, points, rounds, quality)))
    assert (hypotheses, counts[0]) < (45, 4) or not same_bits(tuple(optimize(start, points, 10, quality)), tuple(start))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 60), st.integers(1, 40), st.integers(0, 2**31), st.sampled_from(DTYPES))
def test_distinct_poses(count, most, seed, dtype):
    generator = torch.Generator().manual_seed(seed)
    vectors = torch.randint(3, (12, count), generator=generator).to(dtype)
    pair = torch.randint(3, (count,), generator=generator).sort().values
    assert_same(lambda: spread_out(vectors, pair, [1.0, 2.0, 3.0], most))


@pytest.mark.parametrize("solver", [tr.CompatibilityOptions(nodes=400), tr.RansacOptions(hypotheses=5000)])
def test_whole_solutions(solver):
    problems = [match_problem(count, 0.7, noise=0.05, seed=count) for count in (600, 90, 300)]
    clouds = pack_problems(problems)
    solvers = [solver] * 3
    assert_same(lambda: tuple(poses[:5] for poses in tr.solvers.poses_of_pairs(*clouds, solvers)))
