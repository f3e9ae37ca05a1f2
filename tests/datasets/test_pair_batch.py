"""Packing pairs: unpacking gives them back, and what cannot be packed is refused."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from folders import cloud, motion
from refusals import refuses

from torchreg.datasets import ScanPair, ScanPairBatch, pack_pairs

UNKNOWN = torch.full((4, 4), float("nan"), dtype=torch.float64)


def pair(seed, information=False, **options):
    matrix = torch.full((6, 6), float(seed), dtype=torch.float64) if information else None
    return ScanPair(cloud(seed, **options), cloud(seed + 1, **options), motion(seed), f"pair {seed}", matrix)


@pytest.mark.parametrize("options", [{}, {"colors": False}, {"normals": True, "far": True}])
def test_unpack_undoes_pack(options):
    pairs = [
        pair(0, **options),
        pair(5, information=True, **options),
        replace(pair(3, **options), T_target_source=UNKNOWN),
    ]
    batch = pack_pairs(pairs)
    assert len(batch) == 3
    assert batch.names == ("pair 0", "pair 5", "pair 3")
    assert batch.has_truth.tolist() == [True, True, False]
    assert same_bits(tuple(batch.unpack()), tuple(pairs))


def test_information_is_there_where_a_pair_has_some():
    assert pack_pairs([pair(0), pair(1)]).information is None
    information = pack_pairs([pair(0), pair(1, information=True)]).information
    assert information.isnan().flatten(1).all(dim=1).tolist() == [True, False]


def test_to_changes_clouds_and_keeps_truth_in_double_precision():
    batch = pack_pairs([pair(0, information=True), pair(1)]).to("cpu", torch.float64)
    assert batch.source.points.dtype == batch.target.points.dtype == torch.float64
    far = batch.to("meta")
    assert far.source.device.type == far.T_target_source.device.type == far.information.device.type == "meta"
    assert far.to(dtype=torch.float32).T_target_source.dtype == torch.float64


def test_refused():
    with refuses("pairs", "at least one pair"):
        pack_pairs([])
    batch = pack_pairs([pair(0), pair(1)])
    T = batch.T_target_source
    with refuses("source", "1 clouds, one for every name", "got 2"):
        ScanPairBatch(batch.source, batch.target, T[:1], ("a",))
    with refuses("target", "2 clouds"):
        ScanPairBatch(batch.source, batch.target.select(0), T, batch.names)
    with refuses("T_target_source", "(2, 4, 4)"):
        ScanPairBatch(batch.source, batch.target, T[0], batch.names)
    with refuses("T_target_source", "float64"):
        ScanPairBatch(batch.source, batch.target, T.float(), batch.names)
    with refuses("information", "(2, 6, 6)"):
        ScanPairBatch(batch.source, batch.target, T, batch.names, T)
