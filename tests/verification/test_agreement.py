"""Matches support a pose by as much as chance would not bring."""

import torch
from problems import random_transform

from torchreg.verification.agreement import MatchEndpoints, agreement, match_cells


def problem(inliers, outliers, seed=0):
    g = torch.Generator().manual_seed(seed)
    T = random_transform(g).double()
    source = torch.rand(inliers + outliers, 3, generator=g, dtype=torch.float64) * 5
    target = source @ T[:3, :3].t() + T[:3, 3]
    target[inliers:] = target[inliers:][torch.randperm(outliers, generator=g)]
    return MatchEndpoints(source, target), T


def test_more_matches_surprise_more():
    surprises = []
    for inliers in (0, 5, 20, 80):
        matched, T = problem(inliers, 500)
        weighed = agreement(match_cells(matched, 0.1), T[None, :3, :3], T[None, :3, 3])
        assert int(weighed.support) >= inliers
        surprises.append(float(weighed.surprise))
    assert surprises == sorted(surprises)
    assert surprises[0] < 3
    assert surprises[-1] > 50


def test_chance_alone_surprises_nobody():
    worst = 0.0
    for seed in range(20):
        matched, _ = problem(0, 400, seed=seed)
        other = random_transform(torch.Generator().manual_seed(100 + seed)).double()
        shift = matched.target.mean(dim=0) - other[:3, :3] @ matched.source.mean(dim=0)
        worst = max(worst, float(agreement(match_cells(matched, 0.3), other[None, :3, :3], shift[None]).surprise))
    assert worst < 4


def test_no_matches_support_nothing():
    empty = MatchEndpoints(torch.zeros(0, 3, dtype=torch.float64), torch.zeros(0, 3, dtype=torch.float64))
    weighed = agreement(
        match_cells(empty, 0.1), torch.eye(3, dtype=torch.float64)[None], torch.zeros(1, 3, dtype=torch.float64)
    )
    assert weighed.support.tolist() == [0]
    assert weighed.surprise.tolist() == [0.0]


def test_cells_are_those_of_unique_corners():
    matched, _ = problem(100, 300)
    cells = match_cells(matched, 0.1)
    corner = torch.floor((matched.source - matched.source.amin(dim=0)) / 0.35)
    _, cell, size = corner.unique(dim=0, return_inverse=True, return_counts=True)
    order = cell.argsort(stable=True)
    assert torch.equal(cells.size, size)
    assert torch.equal(cells.last, size.cumsum(0) - 1)
    assert torch.equal(cells.source, matched.source[order].t())
    assert torch.equal(cells.targets[:, 0], matched.target[order].t())
