"""Correspondences check their shapes and dtypes."""

import pytest
import torch
from refusals import refuses

import torchreg as tr

FIELDS = {
    "source": torch.tensor([0, 1, 2]),
    "target": torch.tensor([2, 1, 0]),
    "offsets": torch.tensor([0, 2, 3]),
    "score": torch.zeros(3),
}


def test_pairs_are_counted():
    assert len(tr.Correspondences(**FIELDS)) == 2


@pytest.mark.parametrize(
    ("fields", "name", "parts"),
    [
        ({"source": torch.zeros(3, 2, dtype=torch.int64)}, "source", ["(M,)", "(3, 2)"]),
        ({"source": torch.zeros(3)}, "source", ["int64", "float32"]),
        ({"target": torch.zeros(2, dtype=torch.int64)}, "target", ["(3,)", "(2,)"]),
        ({"target": torch.zeros(3, dtype=torch.int32)}, "target", ["int64", "int32"]),
        ({"target": torch.zeros(3, dtype=torch.int64, device="meta")}, "target", ["cpu", "meta"]),
        ({"score": torch.zeros(4)}, "score", ["(3,)", "(4,)"]),
        ({"score": torch.zeros(3, dtype=torch.int64)}, "score", ["floating", "int64"]),
        ({"score": torch.zeros(3, device="meta")}, "score", ["cpu", "meta"]),
        ({"offsets": torch.tensor([0, 2])}, "offsets", ["0 to 3", "[0, 2]"]),
    ],
)
def test_what_does_not_fit_is_refused(fields, name, parts):
    with refuses(name, *parts):
        tr.Correspondences(**(FIELDS | fields))
