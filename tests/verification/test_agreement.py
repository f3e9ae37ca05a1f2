"""Matches speak for a pose by as much as chance would not bring."""

import torch
from problems import random_transform

from torchreg.verification.agreement import Matched, agreement, places


def problem(inliers, outliers, seed=0):
    g = torch.Generator().manual_seed(seed)
    T = random_transform(g).double()
    source = torch.rand(inliers + outliers, 3, generator=g, dtype=torch.float64) * 5
    target = source @ T[:3, :3].t() + T[:3, 3]
    target[inliers:] = target[inliers:][torch.randperm(outliers, generator=g)]
    return Matched(source, target), T


def test_more_matches_surprise_more():
    found = []
    for inliers in (0, 5, 20, 80):
        matched, T = problem(inliers, 500)
        told = agreement(places(matched, 0.1), T[None, :3, :3], T[None, :3, 3])
        assert int(told.support) >= inliers
        found.append(float(told.surprise))
    assert found == sorted(found)
    assert found[0] < 3
    assert found[-1] > 50


def test_chance_alone_surprises_nobody():
    worst = 0.0
    for seed in range(20):
        matched, _ = problem(0, 400, seed=seed)
        other = random_transform(torch.Generator().manual_seed(100 + seed)).double()
        shift = matched.target.mean(dim=0) - other[:3, :3] @ matched.source.mean(dim=0)
        worst = max(worst, float(agreement(places(matched, 0.3), other[None, :3, :3], shift[None]).surprise))
    assert worst < 4


def test_no_matches_say_nothing():
    empty = Matched(torch.zeros(0, 3, dtype=torch.float64), torch.zeros(0, 3, dtype=torch.float64))
    told = agreement(
        places(empty, 0.1), torch.eye(3, dtype=torch.float64)[None], torch.zeros(1, 3, dtype=torch.float64)
    )
    assert told.support.tolist() == [0]
    assert told.surprise.tolist() == [0.0]
