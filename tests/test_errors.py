"""Messages say what came: the shape of a tensor, the value of anything else."""

import pytest
import torch

from torchreg.errors import describe, expect


def test_a_tensor_is_described_by_shape_dtype_and_device():
    assert describe(torch.zeros(2, 3, dtype=torch.float64)) == "(2, 3) float64 on cpu"


def test_a_long_value_is_shortened():
    assert len(describe(list(range(1000)))) == 80
    assert describe("a") == "'a'"


def test_expect_raises_only_when_it_must():
    expect(True, "x", "anything", 1)
    with pytest.raises(ValueError, match=r"^x: expected more, got 1$"):
        expect(False, "x", "more", 1)
