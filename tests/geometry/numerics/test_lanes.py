"""Sums in lanes are sums, whatever stands beside them and however far rows are filled up."""

import pytest
import torch

from torchreg.geometry.numerics.lanes import LANES, lane_sums


@pytest.mark.parametrize("count", [1, 63, 64, 65, 1000])
def test_zeros_behind_the_last_entry_change_nothing(count):
    values = torch.randn(5, count, generator=torch.Generator().manual_seed(count), dtype=torch.float64)
    sums = [
        lane_sums(torch.nn.functional.pad(values, (0, blocks * LANES - count)))
        for blocks in range(-(-count // LANES), 20, 3)
    ]
    assert all(torch.equal(each, sums[0]) for each in sums)
    assert torch.allclose(sums[0], values.sum(dim=1), atol=1e-12)


def test_the_order_is_that_of_the_lanes():
    values = torch.randn(3 * LANES, generator=torch.Generator().manual_seed(0)).tolist()
    lanes = [values[lane] + values[lane + LANES] + values[lane + 2 * LANES] for lane in range(LANES)]
    while len(lanes) > 1:
        half = len(lanes) // 2
        lanes = [one + other for one, other in zip(lanes[:half], lanes[half:], strict=True)]
    assert float(lane_sums(torch.tensor(values, dtype=torch.float64))) == lanes[0]


def test_any_dimension_is_summed():
    values = torch.randn(4, 2 * LANES, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    assert torch.equal(lane_sums(values, dim=1), lane_sums(values.transpose(1, 2).contiguous()))
