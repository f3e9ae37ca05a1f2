"""Kernels of normals and eigenvectors: the bits of the functions in torch, which keep their own tests."""

import pytest
import torch
from kernel_cases import COUNTS, KINDS, cloud_of, same_both_ways, supports

import torchreg as tr
from torchreg.geometry.eigen import symmetric_eigen
from torchreg.native import native_library

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")

both_types = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])


@both_types
@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", KINDS)
def test_normals_are_those_of_torch(count, kind, dtype):
    cloud = cloud_of(count, dtype=dtype)
    near = supports(cloud)[kind]
    assert same_both_ways(lambda: tr.estimate_normals(cloud, near).normals)
    at_a_point = cloud.points[0] if count else torch.zeros(3, dtype=dtype)
    assert same_both_ways(lambda: tr.estimate_normals(cloud, near, viewpoint=at_a_point).normals)


@both_types
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e15])
def test_eigenvectors_are_those_of_torch(dtype, scale):
    g = torch.Generator().manual_seed(2)
    matrices = (torch.randn(301, 3, 3, generator=g, dtype=dtype) * scale).to(dtype)
    matrices[:40] = torch.diag_embed(torch.randint(-2, 3, (40, 3), generator=g).to(dtype))
    matrices[40:60] *= torch.rand(20, 3, 3, generator=g) < 0.5
    matrices[60:70, 0, 1] = torch.finfo(dtype).tiny
    matrices[70, 0, 0], matrices[71, 1, 2], matrices[72] = torch.nan, torch.inf, torch.nan
    assert same_both_ways(lambda: symmetric_eigen(matrices))
    assert same_both_ways(lambda: symmetric_eigen(matrices[:300].reshape(3, 100, 3, 3).transpose(0, 1)))
    assert same_both_ways(lambda: symmetric_eigen(matrices[:0]))
