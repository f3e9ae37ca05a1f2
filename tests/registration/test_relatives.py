"""Descriptors of the literature register, each alone and fused, by ``register`` and its options alone."""

from dataclasses import replace

import pytest
import torch
from problems import room_pair

import torchreg as tr
from torchreg.descriptors import DESCRIPTORS

RELATIVES = (tr.Pfh, tr.PfhRgb, tr.SpinImages, tr.ShapeContext)
SETS = [*((kind,) for kind in RELATIVES), (tr.Fpfh, *RELATIVES)]


@pytest.mark.parametrize("kinds", SETS, ids=lambda kinds: " + ".join(kind.name for kind in kinds))
def test_a_pair_is_registered_by_them(kinds):
    pair = room_pair(2000)
    spacing = float(tr.spacing(pair.source)[0])
    records = tuple(kind(radius=5 * spacing, max_neighbors=60) for kind in kinds)
    options = replace(tr.options_for(spacing), descriptors=records, weights=None, effort="fast")
    result = tr.register(pair.source, pair.target, options)
    assert float(tr.metrics.rre(pair.T_target_source, result.T_target_source)) < 2
    assert float(result.probability) > 0.5, result.reason


@pytest.mark.parametrize("kind", RELATIVES)
def test_a_record_scales_and_says_how_far_it_reads(kind):
    record = kind(radius=0.5)
    assert DESCRIPTORS[kind.name] is kind
    assert record.scaled(2) == kind(radius=1.0)
    cloud = room_pair(400).source
    near = tr.neighbors(cloud, record.radius, record.max_neighbors)
    cloud = tr.estimate_normals(cloud, near)
    whole = record.describe(cloud, near).values
    kept = (cloud.points - cloud.points[7]).norm(dim=1) <= record.reach * 1.0001
    part = cloud.rows(kept.nonzero()[:, 0], torch.tensor([0, int(kept.sum())]))
    place = int(kept[:7].sum())
    again = record.describe(part, tr.neighbors(part, record.radius, record.max_neighbors)).values
    assert torch.equal(again[place], whole[7])
