"""Features check their shapes, and give their blocks by name."""

import pytest
import torch
from refusals import refuses

import torchreg as tr

FIELDS = {
    "values": torch.arange(10.0).reshape(2, 5),
    "offsets": torch.tensor([0, 1, 2]),
    "blocks": (("fpfh", 3), ("pcfh", 2)),
    "valid": torch.ones(2, dtype=torch.bool),
}


def test_blocks_by_name():
    features = tr.Features(**FIELDS)
    assert len(features) == 2
    assert features.block("fpfh").tolist() == [[0, 1, 2], [5, 6, 7]]
    assert features.block("pcfh").tolist() == [[3, 4], [8, 9]]
    with pytest.raises(ValueError, match=r"name: expected one of \['fpfh', 'pcfh'\], got 'contrast'"):
        features.block("contrast")


@pytest.mark.parametrize(
    ("fields", "name", "parts"),
    [
        ({"values": torch.zeros(2)}, "values", ["(P, D)", "(2,)"]),
        ({"values": torch.zeros(2, 5, dtype=torch.int64)}, "values", ["floating", "int64"]),
        ({"offsets": torch.tensor([0, 3])}, "offsets", ["0 to 2", "[0, 3]"]),
        ({"blocks": (("fpfh", 3),)}, "blocks", ["sum to 5", "fpfh"]),
        ({"valid": torch.ones(3, dtype=torch.bool)}, "valid", ["(2,)", "(3,)"]),
        ({"valid": torch.ones(2)}, "valid", ["bool", "float32"]),
        ({"valid": torch.ones(2, dtype=torch.bool, device="meta")}, "valid", ["cpu", "meta"]),
    ],
)
def test_what_does_not_fit_is_refused(fields, name, parts):
    with refuses(name, *parts):
        tr.Features(**(FIELDS | fields))
