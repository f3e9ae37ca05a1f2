"""Rotation vectors and rotations are each other's inverse, up to half a turn."""

import math

import pytest
import torch
from closeness import assert_rigid, close
from hypothesis import given
from hypothesis import strategies as st
from problems import numbers, turned

from torchreg.geometry.se3 import rigid
from torchreg.geometry.small_motions import cross_matrix, rotation_of, rotation_vector

ANGLES = [0.0, 1e-12, 1e-6, 9e-5, 1.1e-4, 0.3, 2.0, 3.1, math.pi - 1e-4, math.pi - 1e-9]


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("axis", [(1.0, 0, 0), (0, 0, -1.0), (0.3, -0.5, 0.9)])
def test_there_and_back(angle, axis):
    vector = angle * torch.nn.functional.normalize(torch.tensor(axis, dtype=torch.float64), dim=0)
    R = rotation_of(vector)
    assert close(R, turned(math.degrees(angle), axis)[:3, :3], 1e-12)
    assert close(rotation_vector(R), vector, 1e-7)


@given(st.integers(0, 2**20), st.floats(1e-9, 3.1))
def test_any_vector(seed, angle):
    vector = angle * torch.nn.functional.normalize(numbers(5, 3, seed=seed), dim=1)
    R = rotation_of(vector)
    assert_rigid(rigid(R, torch.zeros(5, 3, dtype=torch.float64)), 1e-12)
    assert close(rotation_vector(R), vector, 1e-10)


def test_half_a_turn_has_its_length():
    R = torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
    assert close(rotation_vector(R).abs(), torch.tensor([0.0, 0.0, math.pi], dtype=torch.float64), 1e-12)


def test_the_cross_matrix_multiplies():
    one, other = numbers(2, 4, 3)
    product = (cross_matrix(one) @ other[..., None])[..., 0]
    assert close(product, torch.linalg.cross(one, other), 1e-14)
