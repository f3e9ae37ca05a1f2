"""Gathering row by row gives what indexing gives."""

import pytest
import torch

from torchreg.geometry.numerics.gather import gather, gather_columns


@pytest.mark.parametrize("shape", [(0,), (5,), (2, 3), (2, 0, 3)])
def test_gathering_is_indexing(shape):
    rows = torch.randn(4, 9, generator=torch.Generator().manual_seed(1))
    index = torch.randint(9, shape, generator=torch.Generator().manual_seed(2))
    assert torch.equal(gather(rows[0], index), rows[0][index])
    assert torch.equal(gather_columns(rows, index), rows[:, index])
