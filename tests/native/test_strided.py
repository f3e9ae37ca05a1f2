"""Rows of tensors as kernels take them."""

import pytest
import torch

from torchreg.native import rows

TABLE = torch.arange(60).view(6, 10)


@pytest.mark.parametrize(
    "view",
    [TABLE, TABLE[:, :3], TABLE[2:, 4:7], TABLE[::2], TABLE[:, ::3], TABLE.t(), TABLE[:1].expand(4, 10), TABLE[:, :1]],
    ids=str,
)
def test_rows_are_read_at_their_stride(view):
    memory, stride = rows(view)
    assert memory.is_contiguous()
    read = [memory[row * stride : row * stride + view.shape[1]].tolist() for row in range(len(view))]
    assert read == view.tolist()


@pytest.mark.parametrize("view", [TABLE, TABLE[:, :3], TABLE[2:, 4:7], TABLE[::2]], ids=str)
def test_views_whose_rows_are_whole_are_not_copied(view):
    assert rows(view)[0].data_ptr() == view.data_ptr()


def test_nothing_is_left_of_an_empty_table():
    assert rows(TABLE[:0])[0].numel() == rows(TABLE[:, :0])[0].numel() == 0
