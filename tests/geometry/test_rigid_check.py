"""A matrix from outside is a rigid transform, or it is said what it is instead."""

import pytest
import torch
from problems import random_transform, seeded
from refusals import refuses

from torchreg.geometry.rigid_check import expect_rigid


def scaled(*factors):
    return torch.diag(torch.tensor([*factors, 1.0], dtype=torch.float64))


@pytest.mark.parametrize("seed", range(5))
def test_rigid_transforms_pass_and_what_is_multiplied_onto_them_is_named(seed):
    T = random_transform(seeded(seed))
    expect_rigid(T, "T")
    for factors, parts in (
        ((0.5, 0.5, 0.5), ["a scale of 0.5", "determinant 0.125"]),
        ((1.001, 1.001, 1.001), ["a scale of 1.001"]),
        ((1.0, -1.0, 1.0), ["a reflection", "determinant -1"]),
        ((-3.0, 3.0, 3.0), ["a reflection, a scale of 3", "determinant -27"]),
        ((1.0, 1.0, 2.0), ["R R^T off by", "determinant 2"]),
    ):
        with refuses("T", *parts):
            expect_rigid(T @ scaled(*factors), "T")


def test_a_shear_is_no_scale():
    with pytest.raises(ValueError, match="got R R"):
        expect_rigid(scaled(1.0, 1.0, 2.0), "T")


def test_shape_numbers_and_last_row():
    with refuses("T", "(4, 4)", "(3, 3)"):
        expect_rigid(torch.eye(3, dtype=torch.float64), "T")
    T = torch.eye(4, dtype=torch.float64)
    T[0, 3] = torch.inf
    with refuses("T", "finite"):
        expect_rigid(T, "T")
    T = torch.eye(4, dtype=torch.float64)
    T[3, 0] = 1e-3
    with refuses("T", "a last row 0 0 0 1"):
        expect_rigid(T, "T")
