"""Fusion: blocks of unit length, zero blocks kept, weights, and what is valid."""

import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.fuse import unit_rows


def features(values, name="one", valid=None):
    values = torch.as_tensor(values, dtype=torch.float64)
    valid = (values != 0).any(dim=1) if valid is None else torch.tensor(valid)
    return tr.Features(values, torch.tensor([0, len(values)]), ((name, values.shape[1]),), valid)


def described_room(count=400):
    scan = room_pair(count).source
    near = tr.neighbors(scan, 1.2, 60)
    scan = tr.estimate_normals(scan, near.restrict(0.6, 30))
    return tr.fpfh(scan, near), tr.pcfh(scan, near.restrict(0.8))


def test_fpfh_and_pcfh_make_44_columns_of_unit_blocks():
    geometry, color = described_room()
    fused = tr.fuse(geometry, color)
    assert fused.values.shape[1] == 44
    assert fused.blocks == (("fpfh", 33), ("pcfh", 11))
    for part, block in ((geometry, fused.block("fpfh")), (color, fused.block("pcfh"))):
        length = torch.linalg.vector_norm(block, dim=1)
        assert close(length[part.valid], torch.ones(()), atol=1e-6)
        assert not block[~part.valid].any()
        cosine = torch.nn.functional.cosine_similarity(block[part.valid], part.values[part.valid])
        assert close(cosine, torch.ones(()), atol=1e-6)


def test_weights_are_the_lengths_of_blocks():
    geometry, color = described_room()
    fused = tr.fuse(geometry, color, weights=(2.0, 0.5))
    plain = tr.fuse(geometry, color)
    assert torch.allclose(fused.block("fpfh"), 2 * plain.block("fpfh"))
    assert torch.allclose(fused.block("pcfh"), 0.5 * plain.block("pcfh"))
    assert same_bits(tr.fuse(geometry, color, weights=(1.0, 1.0)), plain)


def test_the_scale_of_a_descriptor_does_not_matter():
    geometry, color = described_room()
    louder = tr.Features(color.values * 128, color.offsets, color.blocks, color.valid)
    assert same_bits(tr.fuse(geometry, louder), tr.fuse(geometry, color))


def test_a_row_takes_part_with_a_zero_block_and_not_with_zeros_alone():
    fused = tr.fuse(features([[3.0, 4], [0, 0], [0, 0]]), features([[0.0], [2], [0]]))
    assert fused.values.tolist() == [[0.6, 0.8, 0], [0, 0, 1], [0, 0, 0]]
    assert fused.valid.tolist() == [True, True, False]


def test_a_row_of_zeros_is_not_valid_whatever_its_parts_claim():
    fused = tr.fuse(features([[0.0, 0], [1, 0]], valid=[True, True]), features([[0.0], [0]], valid=[True, False]))
    assert fused.valid.tolist() == [False, True]


def test_rows_that_are_not_valid_are_never_matched():
    one = tr.fuse(features([[1.0, 0], [0, 0]]))
    other = tr.fuse(features([[0.0, 0], [1, 0], [0, 0]]))
    matches = tr.match_mutual(one, other)
    assert matches.source.tolist() == [0]
    assert matches.target.tolist() == [1]


def test_one_descriptor_alone_is_scaled():
    assert tr.fuse(features([[0.0, 5]])).values.tolist() == [[0, 1]]


def test_fused_features_can_be_fused_again():
    geometry, color = described_room()
    again = tr.fuse(tr.fuse(geometry, color), color)
    assert again.blocks == (("fpfh", 33), ("pcfh", 11), ("pcfh", 11))


def test_a_row_has_its_bits_whatever_stands_beside_it():
    values = torch.rand(3001, 33, generator=torch.Generator().manual_seed(0))
    together = unit_rows(values)
    for cut in (slice(0, 1), slice(5, 18), slice(1000, 3001)):
        assert same_bits(unit_rows(values[cut]), together[cut])
    for number in THREADS:
        with threads(number):
            assert same_bits(unit_rows(values), together)


def test_gradients_are_right_and_finite_for_zero_rows():
    values = torch.rand(4, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(unit_rows, values)
    zero = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    unit_rows(zero).sum().backward()
    assert torch.isfinite(zero.grad).all()


def test_what_does_not_fit_is_refused():
    one = features([[1.0, 0], [0, 1]])
    with refuses("features", "at least one"):
        tr.fuse()
    with refuses("weights", "(2)", "(1.0,)"):
        tr.fuse(one, one, weights=(1.0,))
    with refuses("features", "same points"):
        tr.fuse(one, features([[1.0]]))


@pytest.mark.parametrize("weight", [0.0, -1.0, float("nan"), float("inf")])
def test_a_weight_that_is_none_is_refused(weight):
    with refuses("weights", "above 0"):
        tr.fuse(features([[1.0]]), weights=(weight,))
