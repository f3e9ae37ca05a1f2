"""Local frames, SHOT and unique shape contexts against PCL's values, on the same normals and neighborhoods.

``bench/reference.py values`` wrote the files, on the cloud of ``test_pcl_values.py``.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from closeness import close

import torchreg as tr
from torchreg.descriptors.lab import lab
from torchreg.native import native_kernels

VALUES = Path(__file__).parent / "pcl"
both_ways = pytest.mark.parametrize("compiled", [True, False])
either_dtype = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])


def given(dtype=torch.float32):
    numbers = torch.from_numpy(np.loadtxt(VALUES / "cloud.txt", dtype=np.float32)).to(dtype)
    points, normals, colors = (part.contiguous() for part in numbers.split(3, dim=1))
    cloud = tr.Clouds(points=points, normals=normals, colors=colors / 255)
    return cloud, tr.neighbors(cloud, 0.5, len(points))


def of_pcl(name, dtype=torch.float32):
    with np.load(VALUES / f"{name}.npz") as file:
        return torch.from_numpy(file["values"]).to(dtype)


def lab_of_pcl(colors):
    """Coordinates of color off PCL's tables: 256 steps of a channel, 4000 of what the cube root is taken of."""
    channel, steps = torch.arange(256) / 255, torch.arange(4000) / 4000
    light = torch.where(channel > 0.04045, ((channel + 0.055) / 1.055) ** 2.4, channel / 12.92)
    root = torch.where(steps > 0.008856, steps ** (1 / 3), 7.87 * steps + 16 / 116)
    red, green, blue = light[(colors * 255).round().long()].unbind(1)
    x = (red * 0.412453 + green * 0.357580 + blue * 0.180423) / 0.95047
    y = red * 0.212671 + green * 0.715160 + blue * 0.072169
    z = (red * 0.019334 + green * 0.119193 + blue * 0.950227) / 1.08883
    fx, fy, fz = (root[(part * 4000).long().clamp(max=3999)] for part in (x, y, z))
    return torch.stack([1.16 * fy - 0.16, 500 / 120 * (fx - fy), 200 / 120 * (fy - fz)], dim=1)


@both_ways
@either_dtype
def test_local_frames(dtype, compiled):
    cloud, near = given(dtype)
    with native_kernels(compiled):
        assert close(tr.local_frames(cloud, near).flatten(1), of_pcl("local_frames", dtype), atol=1e-5)


@both_ways
@either_dtype
def test_shot(dtype, compiled):
    cloud, near = given(dtype)
    with native_kernels(compiled):
        assert close(tr.shot(cloud, near).values, of_pcl("shot", dtype), atol=2e-6)


@both_ways
@either_dtype
def test_cshot_with_pcls_table_of_colors(dtype, compiled):
    cloud, near = given(dtype)
    with native_kernels(compiled):
        found = tr.cshot(cloud, near, values=lab_of_pcl(cloud.colors.float()).to(dtype)).values
    assert close(found, of_pcl("cshot", dtype), atol=2e-6)


def test_cshot_with_exact_colors_differs_by_the_steps_of_the_table():
    cloud, near = given()
    exact = lab(cloud.colors)
    assert 1e-3 < (exact - lab_of_pcl(cloud.colors)).abs().max() < 1e-2
    found, expected = tr.cshot(cloud, near).values, of_pcl("cshot")
    assert close(found[:, :352] / found[:, :352].norm(dim=1, keepdim=True), of_pcl("shot"), atol=2e-6)
    assert (found * expected).sum(dim=1).min() > 0.98  # cosine of rows of length 1


@either_dtype
def test_unique_shape_context(dtype):
    cloud, near = given(dtype)
    expected = of_pcl("unique_shape_context", dtype)
    gap = (tr.unique_shape_context(cloud, near).values - expected).abs().amax(dim=1) / expected.amax()
    assert gap.max() < 2e-6


def test_another_radius_is_noticed():
    cloud, near = given()
    wider = replace(near, radius=0.51)
    assert not close(tr.shot(cloud, wider).values, of_pcl("shot"), atol=1e-3)
