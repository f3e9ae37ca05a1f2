"""One made record of every type, and batches of several items."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from problems import seeded, turned
from results import failed_result, verification, verified_result
from sites import link_of, made_poses, site_of_poses

import torchreg as tr
from torchreg.datasets import ScanPair, ScanPairBatch, SimulatedSite
from torchreg.site.result import SiteLink
from torchreg.types.record import PackedBatch, Record


def cloud(seed: int = 0, rows: int | None = None, **changes: object) -> tr.Clouds:
    """One cloud with everything, of ``seed`` + 2 points."""
    generator, count = seeded(seed), seed + 2 if rows is None else rows

    def numbers(*shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        return torch.rand(*shape, generator=generator, dtype=dtype)

    fields = {
        "points": numbers(count, 3),
        "colors": numbers(count, 3),
        "normals": numbers(count, 3),
        "origin": numbers(1, 3, dtype=torch.float64),
        "viewpoint": numbers(1, 3),
        "viewpoint_assumed": torch.tensor([seed % 2 == 0]),
    }
    return tr.Clouds(**(fields | changes))


def features(seed: int = 0) -> tr.Features:
    """Of one cloud."""
    rows = seed + 3
    values = torch.rand(rows, 5, generator=seeded(seed))
    return tr.Features(values, torch.tensor([0, rows]), (("fpfh", 3), ("pcfh", 2)), torch.arange(rows) > 0)


def matches(seed: int = 0) -> tr.Correspondences:
    """Of one pair."""
    count = seed + 1
    rows = torch.arange(count)
    return tr.Correspondences(rows, rows.flip(0), torch.tensor([0, count]), torch.rand(count, generator=seeded(seed)))


def soft_matches(seed: int = 0) -> tr.SoftCorrespondences:
    """Of one pair."""
    rows = seed + 2
    confidence = torch.rand(rows, 4, generator=seeded(seed))
    return tr.SoftCorrespondences((confidence,), torch.tensor([0, rows]), torch.tensor([0, 4]))


def result(seed: int = 0) -> tr.RegistrationResult:
    """Of one pair; one of two failed."""
    one = failed_result("ambiguous") if seed % 2 else verified_result()
    clouds = {"source": cloud(seed, rows=6 + seed), "target": cloud(seed + 1, rows=7 + seed)}
    return replace(one, correspondences=matches(3 + seed), inliers=torch.arange(4 + seed) > 1, **clouds)


def checked(seed: int = 0) -> tr.Verification:
    """Of one pair."""
    return verification(search=result(seed), fitness=torch.tensor([seed / 10], dtype=torch.float64))


def icp_result(seed: int = 0) -> tr.IcpResult:
    """Of one pair; one of two failed."""
    number = torch.tensor([seed / 10], dtype=torch.float64)
    failure = tr.Failure("motion open", "the motion is open") if seed % 2 else None
    converged = torch.tensor([failure is None])
    return tr.IcpResult(turned(seed)[None], number, number, torch.tensor([seed]), converged, (failure,))


def pair_batch(seed: int = 0) -> ScanPairBatch:
    """Of one pair."""
    information = torch.eye(6, dtype=torch.float64)[None] * seed
    return ScanPairBatch(cloud(seed), cloud(seed + 1), turned(seed)[None], (f"<pair {seed}>",), information)


BATCHES: dict[type[PackedBatch], Callable[[int], PackedBatch]] = {
    tr.Clouds: cloud,
    tr.Features: features,
    tr.Correspondences: matches,
    tr.SoftCorrespondences: soft_matches,
    tr.RegistrationResult: result,
    tr.Verification: checked,
    tr.IcpResult: icp_result,
    ScanPairBatch: pair_batch,
}
"""Of every type that holds several items, what makes a batch of one from a seed."""


def batch_of(kind: type[PackedBatch], count: int = 3) -> PackedBatch:
    """A batch of several items."""
    return kind.pack([BATCHES[kind](seed) for seed in range(count)])


def records() -> dict[type[Record], Record]:
    """One of every type."""
    near = tr.neighbors(tr.Clouds(torch.rand(9, 3, generator=seeded())), 0.5, 4)
    scans = (cloud(0), cloud(1))
    simulated = SimulatedSite(scans, turned(3).repeat(2, 1, 1), torch.zeros(2).long(), ("a", "b"), "site")
    link = link_of((0, 1), turned(5), 1.0)
    links = (SiteLink(link, True, 0.9, 0.1, 0.2, 0, math.nan, math.nan),)
    site = replace(site_of_poses(made_poses(3), [0, 0, 0]), links=links)
    others = (near, ScanPair(*scans, turned(3), "a pair"), simulated, link, site)
    return {kind: batch_of(kind) for kind in BATCHES} | {type(other): other for other in others}


def all_kinds(kind: type[Record] = Record) -> set[type[Record]]:
    """Every type there is, but those that others are made of."""
    below = {one for child in kind.__subclasses__() for one in all_kinds(child)}
    return below if kind in (Record, PackedBatch) else below | {kind}
