"""Kernels of descriptors: the bits of the functions in torch, which keep their own tests."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from kernel_cases import COUNTS, KINDS, cloud_of, same_both_ways, supports

import torchreg as tr
from torchreg.descriptors.fpfh import simplified_histograms
from torchreg.descriptors.histograms import add_weighted_neighbors
from torchreg.native import native_library, torch_on_one_thread

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")

DESCRIPTORS = [
    tr.estimate_normals,
    tr.fpfh,
    tr.pcfh,
    lambda cloud, near: tr.contrast(cloud, near, 0.4),
    tr.pfh,
    tr.pfhrgb,
    tr.local_frames,
    tr.shot,
    tr.cshot,
]
everywhere = pytest.mark.parametrize(("count", "kind"), [(count, kind) for count in COUNTS for kind in KINDS])


@everywhere
def test_simplified_histograms_are_those_of_torch(count, kind):
    cloud = cloud_of(count)
    near = supports(cloud)[kind]
    assert same_both_ways(lambda: simplified_histograms(cloud.points, cloud.normals, near))


@everywhere
@pytest.mark.parametrize(("columns", "bins"), [(33, 11), (11, 11), (7, 7), (64, 4), (35, 7)])
def test_weighted_sums_are_those_of_torch(count, kind, columns, bins):
    near = supports(cloud_of(count))[kind]
    histograms = torch.rand(count, columns, generator=torch.Generator().manual_seed(1)) * 100
    histograms[::3] = 0
    for keep_own in (False, True):
        assert same_both_ways(lambda own=keep_own: add_weighted_neighbors(histograms, near, bins, keep_own=own))


@everywhere
@pytest.mark.parametrize("weighting", [False, True])
@pytest.mark.parametrize("channels", [("hue",), ("value", "hue", "saturation"), ("hue", "hue")])
def test_color_histograms_are_those_of_torch(count, kind, channels, weighting):
    cloud = cloud_of(count)
    near = supports(cloud)[kind]
    assert same_both_ways(lambda: tr.pcfh(cloud, near, bins=9, channels=channels, saturation_weighting=weighting))


@everywhere
def test_contrast_is_that_of_torch(count, kind):
    cloud = cloud_of(count)
    near = supports(cloud)[kind]
    assert same_both_ways(lambda: tr.contrast(cloud, near, 0.5))
    radius = torch.linspace(0.1, 0.6, count)
    assert same_both_ways(lambda: tr.contrast(cloud, near, radius))


@everywhere
@pytest.mark.parametrize("describe", [tr.pfh, tr.pfhrgb])
def test_pair_histograms_are_those_of_torch(count, kind, describe):
    cloud = cloud_of(count)
    near = supports(cloud)[kind]
    assert same_both_ways(lambda: describe(cloud, near))


@pytest.mark.parametrize("seed", range(5))
def test_pair_histograms_are_those_of_torch_on_other_clouds(seed):
    cloud = cloud_of(300, seed)
    near = tr.neighbors(cloud, 0.5, 80)
    assert same_both_ways(lambda: (tr.pfh(cloud, near), tr.pfhrgb(cloud, near)))


@everywhere
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_local_frames_are_those_of_torch(count, kind, dtype):
    cloud = cloud_of(count, dtype=dtype)
    near = replace(supports(cloud)[kind], radius=0.4)
    assert same_both_ways(lambda: tr.local_frames(cloud, near))
    each = replace(near, radius=torch.linspace(0.3, 0.6, count))
    assert same_both_ways(lambda: tr.local_frames(cloud, each))


@everywhere
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_shot_is_that_of_torch(count, kind, dtype):
    cloud = cloud_of(count, dtype=dtype)
    near = replace(supports(cloud)[kind], radius=0.4)
    frames = torch.eye(3, dtype=dtype).expand(count, 3, 3)  # which every cloud has neighbors on the axes of
    for given in (None, frames):
        assert same_both_ways(lambda given=given: tr.shot(cloud, near, frames=given))
        assert same_both_ways(lambda given=given: tr.cshot(cloud, near, frames=given))


@pytest.mark.parametrize("describe", [tr.shot, tr.cshot])
@pytest.mark.parametrize("large", ["points", "normals", "frames"])
def test_shot_of_numbers_whose_products_are_endless_is_that_of_torch(describe, large):
    cloud = cloud_of(300)
    near = replace(supports(cloud)["wide"], radius=0.4)
    frames = 4 * torch.nn.functional.normalize(
        torch.rand(300, 3, 3, generator=torch.Generator().manual_seed(2)) - 0.5, dim=2
    )
    factor = torch.where(torch.arange(300) % 3 == 0, 3e38, 1.0)[:, None]
    if large == "frames":
        frames = frames * (factor * 0.25)[..., None]
    else:
        cloud = replace(cloud, **{large: getattr(cloud, large) * factor})
    assert same_both_ways(lambda: describe(cloud, near, frames=frames))
    assert torch.isfinite(describe(cloud, near, frames=frames).values).all()


@pytest.mark.parametrize("seed", range(5))
def test_fpfh_is_that_of_torch_on_other_clouds(seed):
    cloud = cloud_of(500, seed)
    near = tr.neighbors(cloud, 0.5, 130)
    for mode in ("open3d", "pcl"):
        assert same_both_ways(lambda mode=mode: tr.fpfh(cloud, near, mode=mode))


def test_float64_is_left_to_torch():
    cloud = cloud_of(100, dtype=torch.float64)
    near = tr.neighbors(cloud, 0.5, 30)
    assert same_both_ways(lambda: (tr.fpfh(cloud, near), tr.pcfh(cloud, near), tr.contrast(cloud, near, 0.5)))


def test_gradients_of_inputs_are_dropped_as_in_torch():
    cloud = cloud_of(100)
    near = tr.neighbors(cloud, 0.5, 30)
    points, normals = cloud.points.clone().requires_grad_(), cloud.normals.clone().requires_grad_()
    histograms = simplified_histograms(points, normals, near)
    assert not histograms.requires_grad
    assert same_bits(histograms, simplified_histograms(cloud.points, cloud.normals, near))


@pytest.mark.parametrize("wrong", [-1, 300, 2**62])
@pytest.mark.parametrize("use", DESCRIPTORS)
@pytest.mark.parametrize("number", [1, 4])
def test_a_neighbor_that_is_no_point_is_refused(wrong, use, number):
    cloud = cloud_of(300)
    near = tr.neighbors(cloud, 0.4, 40)
    index = near.index.clone()
    index[211, 39] = wrong
    near = tr.Neighborhoods(index, near.valid, near.sq_distance, near.radius)
    with torch_on_one_thread(number), pytest.raises(IndexError, match="beyond"):
        use(cloud, near)
