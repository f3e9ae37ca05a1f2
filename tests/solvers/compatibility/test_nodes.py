"""The choice among many correspondences: degrees exact, chance as measured, inliers kept."""

import pytest
import torch
from determinism import THREADS, same_bits, threads
from problems import columns

from torchreg.datasets import match_problem
from torchreg.solvers.compatibility import nodes as module
from torchreg.solvers.compatibility.graph import first_order
from torchreg.solvers.compatibility.nodes import choose_nodes, degrees, degrees_among


@pytest.mark.parametrize(("tile", "wide"), [(100, 80), (5000, 80), (1 << 18, 4096)])
def test_degrees_are_the_row_sums_of_the_graph(tile, wide, monkeypatch):
    source, target = columns(match_problem(333, 0.6), torch.float32)
    expected = first_order(source, target, 0.2).sum(dim=1) + 1  # itself
    monkeypatch.setattr(module, "TILE_ELEMENTS", tile)
    monkeypatch.setattr(module, "_COLUMNS", wide)
    assert torch.equal(degrees(source, target, 0.2), expected)
    assert torch.equal(degrees_among((source, target), (source, target), 0.2), expected)


def test_few_are_all_taken():
    source, target = columns(match_problem(50, 0.5), torch.float32)
    assert torch.equal(choose_nodes(source, target, 0.2, 50), torch.arange(50))


def test_chance_explains_the_degrees_of_wrong_matches():
    source, target = columns(match_problem(3000, 1.0, seed=1), torch.float32)
    points = (source, target)
    excess = module._excess(points, points, degrees(source, target, 0.2), 0.2)
    assert abs(float(excess.mean())) < 0.1
    assert float(excess.std()) < 1.2
    # without it, the place in the scene decides
    plain = degrees(source, target, 0.2)
    assert float(plain.std() / plain.mean().sqrt()) > 1.5 * float(excess.std())


@pytest.mark.parametrize("place", ["cube", "room"])
def test_inliers_are_among_the_chosen(place):
    problem = match_problem(5000, 0.98, place=place, noise=0.05, seed=2)
    chosen = choose_nodes(*columns(problem, torch.float32), 0.2, 500)
    assert chosen.shape == (500,)
    assert (chosen.diff() > 0).all()
    assert problem.is_inlier[chosen].sum() > 0.9 * problem.is_inlier.sum()


@pytest.mark.parametrize("place", ["cube", "room"])
def test_the_detail_that_inliers_share_counts_for_them(place):
    above = {}
    for smoothed in (1, module._SMOOTHED):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "_SMOOTHED", smoothed)
            above[smoothed] = sum(standing(match_problem(4000, 0.99, place=place, seed=seed)) for seed in range(4)) / 4
    assert above[module._SMOOTHED] > above[1] + 0.15, above


def standing(problem):
    """How far the excess of inliers is above that of all, in standard deviations."""
    points = columns(problem, torch.float32)
    excess = module._excess(points, points, degrees(*points, 0.2), 0.2)
    return float((excess[problem.is_inlier].mean() - excess.mean()) / excess.std())


def test_the_anchors_are_as_dense_as_the_points():
    points = columns(match_problem(7000, 1.0, place="room"), torch.float32)[0]
    anchors = module._anchors(points)
    assert 0.9 * module._ANCHORS < anchors.shape[1] <= module._ANCHORS
    for axis in range(3):
        shares = [
            (side[axis] < points[axis].quantile(below)).float().mean()
            for below in (0.2, 0.4, 0.6, 0.8)
            for side in (anchors, points)
        ]
        off = torch.stack(shares).view(4, 2).diff(dim=1).abs().max()
        assert off < 0.015  # 0.016 to 0.05 where they are drawn at random


def test_the_order_of_the_matches_does_not_matter():
    problem = match_problem(3000, 0.97, noise=0.05)
    source, target = columns(problem, torch.float32)
    step = torch.randperm(3000, generator=torch.Generator().manual_seed(0))
    one = choose_nodes(source, target, 0.2, 400)
    other = step[choose_nodes(source[:, step].contiguous(), target[:, step].contiguous(), 0.2, 400)]
    common = torch.isin(one, other).float().mean()
    assert common > 0.98  # of equal excess the earlier


def test_neither_threads_nor_tiles_change_the_choice(monkeypatch):
    source, target = columns(match_problem(1500, 0.95), torch.float32)
    expected = choose_nodes(source, target, 0.2, 300)
    for tile in (1 << 16, 1 << 20):
        monkeypatch.setattr(module, "TILE_ELEMENTS", tile)
        for number in THREADS:
            with threads(number):
                assert same_bits(choose_nodes(source, target, 0.2, 300), expected)


def test_coincident_matches_are_no_error():
    points = torch.ones(3, 100)
    assert len(choose_nodes(points, points, 0.2, 10)) == 10
