"""PFH, PFHRGB, spin images and shape contexts against PCL's values, on the same normals and neighborhoods.

``bench/reference.py values`` wrote the files: a wavy sheet of 160 points, the last of which lies where the first one does,
with colors of 8 bits whose ratios often meet the edges of bins.
"""

from pathlib import Path

import numpy as np
import pytest
import torch
from closeness import close

import torchreg as tr
from torchreg.native import native_kernels

VALUES = Path(__file__).parent / "pcl"
RADIUS = 0.5
TWINS = (0, 159)
both_ways = pytest.mark.parametrize("compiled", [True, False])
either_dtype = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])


def given(dtype=torch.float32):
    numbers = torch.from_numpy(np.loadtxt(VALUES / "cloud.txt", dtype=np.float32)).to(dtype)
    points, normals, colors = (part.contiguous() for part in numbers.split(3, dim=1))
    cloud = tr.Clouds(points=points, normals=normals, colors=colors / 255)
    return cloud, tr.neighbors(cloud, RADIUS, len(points))


def of_pcl(name, dtype=torch.float32):
    with np.load(VALUES / f"{name}.npz") as file:
        return torch.from_numpy(file["values"]).to(dtype), torch.from_numpy(file["extra"]).to(dtype)


def has_both_twins(near):
    return torch.stack([((near.index == twin) & near.valid).any(dim=1) for twin in TWINS]).all(dim=0)


@both_ways
@either_dtype
def test_pfh(dtype, compiled):
    cloud, near = given(dtype)
    with native_kernels(compiled):
        assert close(tr.pfh(cloud, near).values, of_pcl("pfh", dtype)[0], atol=5e-4)


@both_ways
@either_dtype
def test_pfhrgb(dtype, compiled):
    cloud, near = given(dtype)
    expected = of_pcl("pfhrgb", dtype)[0]
    with native_kernels(compiled):
        found = tr.pfhrgb(cloud, near).values
    assert close(found[:, :125], expected[:, :125], atol=5e-4)
    # of points in one place PCL counts the color ratios of the pair before, both ways
    together = has_both_twins(near)
    assert 0 < int(together.sum()) < 40
    assert close(found[~together], expected[~together], atol=5e-4)
    counts = near.counts().to(dtype)[:, None]
    votes = (found - expected)[together] * (counts * (counts - 1) / 200)[together]
    assert float(votes.abs().sum(dim=1).max()) < 4.01


@either_dtype
@pytest.mark.parametrize(
    ("name", "options"),
    [("spin_images", {}), ("spin_images_radial", {"support_cosine": 0.5, "structure": "radial"})],
)
def test_spin_images(dtype, name, options):
    cloud, near = given(dtype)
    assert close(tr.spin_images(cloud, near, **options).values, of_pcl(name, dtype)[0], atol=2e-6)


@either_dtype
def test_spin_images_of_angles(dtype):
    cloud, near = given(dtype)
    # PCL takes arccosines of numbers in float32, which hold angles between close normals to 5e-4 alone
    difference = (tr.spin_images(cloud, near, content="angles").values - of_pcl("spin_images_angles", dtype)[0]).abs()
    assert float(difference.max()) < 6e-4
    assert float(difference.median()) < 1e-6


@either_dtype
def test_shape_context(dtype):
    cloud, near = given(dtype)
    expected, frames = of_pcl("shape_context", dtype)
    found = tr.shape_context(cloud, near, frames=frames.view(-1, 3, 3)).values
    assert close(found / expected.amax(), expected / expected.amax(), atol=1e-6)
