"""Pairs to refine: scans of one room, the truth perturbed."""

from dataclasses import replace
from typing import NamedTuple

import pytest
import torch
from problems import room_pair
from torch import Tensor

import torchreg as tr
from torchreg.geometry.se3 import rigid
from torchreg.refinement.gauss_newton import rotation_zyx


class Start(NamedTuple):
    """A pair with colors and normals, the truth, and a transform near it, (1, 4, 4) float64 each."""

    source: tr.Clouds
    target: tr.Clouds
    T_target_source: Tensor
    T_start: Tensor


def perturbation(seed: int, degrees: float, meters: float) -> Tensor:
    """A small rigid motion (4, 4) float64."""
    generator = torch.Generator().manual_seed(seed)
    angles, shift = torch.randn(2, 3, dtype=torch.float64, generator=generator)
    angles, shift = (v / torch.linalg.vector_norm(v) for v in (angles, shift))
    return rigid(rotation_zyx(torch.deg2rad(degrees * angles)[None])[0], meters * shift)


def room_start(seed=0, count=2500, degrees=2.0, meters=0.05, dtype=torch.float64):
    pair = room_pair(count, seed=seed, dtype=dtype)
    source, target = (tr.estimate_normals(cloud, tr.neighbors(cloud, 0.5, 30)) for cloud in (pair.source, pair.target))
    T = perturbation(seed, degrees, meters) @ pair.T_target_source[0]
    clouds = (replace(cloud, viewpoint=None) for cloud in (source, target))
    return Start(*clouds, pair.T_target_source, T[None])


@pytest.fixture(scope="session")
def start():
    """A function that makes a pair: ``start(seed, count, degrees, meters, dtype)``."""
    return room_start


@pytest.fixture(scope="session")
def perturbed():
    """A function that makes a small motion: ``perturbed(seed, degrees, meters)``."""
    return perturbation
