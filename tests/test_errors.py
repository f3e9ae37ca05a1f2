"""Messages say what came: the shape of a tensor, the value of anything else."""

import pytest
import torch

import torchreg as tr
from torchreg.errors import describe, expect, expect_in_words


def test_a_tensor_is_described_by_shape_dtype_and_device():
    assert describe(torch.zeros(2, 3, dtype=torch.float64)) == "(2, 3) float64 on cpu"


def test_a_long_value_is_shortened():
    assert len(describe(list(range(1000)))) == 80
    assert describe("a") == "'a'"


def test_expect_raises_only_when_it_must():
    expect(True, "x", "anything", 1)
    with pytest.raises(ValueError, match=r"^x: expected more, got 1$"):
        expect(False, "x", "more", 1)


def test_words_stand_without_the_quotes_of_a_value():
    expect_in_words(True, "x", "one", "two")
    with pytest.raises(ValueError, match=r"^x: expected one cloud, got 2 clouds$"):
        expect_in_words(False, "x", "one cloud", "2 clouds")
    cloud = tr.Clouds(torch.rand(20, 3))
    broken = torch.full((20, 4), torch.nan)
    with pytest.raises(ValueError, match=r"expected finite numbers, got NaN or infinity in 20 of 20 rows$"):
        tr.register_features(cloud, cloud, broken, broken)
