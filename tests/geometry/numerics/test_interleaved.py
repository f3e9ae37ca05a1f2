"""Interleaved sums against plain ones, and what must not change a bit of them."""

import pytest
import torch
from determinism import same_bits

from torchreg.geometry.numerics.interleaved import interleaved_sum


@pytest.mark.parametrize("width", [1, 2, 15, 16, 17, 40, 100])
def test_sums_are_those_of_sixteen_lanes_one_after_another(width):
    values = torch.randn(5, width, generator=torch.Generator().manual_seed(width))
    expected = []
    for row in values:
        total = 0.0
        for lane in range(min(16, width)):
            entries = row[lane::16]
            kept = entries[0]
            for entry in entries[1:]:
                kept = kept + entry
            total += float(kept)  # in float64
        expected.append(total)
    assert same_bits(interleaved_sum(values), torch.tensor(expected))


def test_zeros_behind_change_nothing():
    values = torch.randn(7, 21, generator=torch.Generator().manual_seed(0))
    longer = torch.nn.functional.pad(values, (0, 60))
    assert same_bits(interleaved_sum(longer), interleaved_sum(values))


def test_gradients_are_those_of_a_sum():
    values = torch.randn(2, 3, 21, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    assert torch.autograd.gradcheck(interleaved_sum, (values,))
