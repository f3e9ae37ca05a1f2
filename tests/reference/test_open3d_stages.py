"""Open3D's stages behind torchreg's types: the same places, the same numbers, whatever the origin."""

import numpy as np
import pytest
import torch
from problems import room_pair, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.open3d_loader import load_open3d
from torchreg.reference import open3d

UTM = torch.tensor([[512345.0, 5234567.0, 431.0]], dtype=torch.float64)


def moved_origin(cloud):
    return tr.Clouds(
        points=cloud.points, colors=cloud.colors, normals=cloud.normals, origin=UTM, viewpoint=cloud.viewpoint
    )


def test_normals_are_those_of_torchreg():
    cloud = room_pair(1500).source
    theirs = open3d.estimate_normals(cloud, 0.5, 30).normals
    ours = tr.estimate_normals(cloud, tr.neighbors(cloud, 0.5, 30)).normals
    assert theirs.dtype == cloud.points.dtype
    cosine = (theirs * ours).sum(dim=1)
    assert (cosine > 0.9999).float().mean() > 0.99


@pytest.mark.parametrize("viewpoint", [None, torch.full((1, 3), float("nan"))])
def test_normals_without_a_viewpoint_face_the_mean_point(viewpoint):
    scan = room_pair(1500).source
    cloud = tr.Clouds(points=scan.points, viewpoint=viewpoint)
    normals = open3d.estimate_normals(cloud, 0.5, 30).normals
    assert bool(((cloud.points.mean(dim=0) - cloud.points) * normals >= 0).any(dim=1).all())
    assert (((cloud.points.mean(dim=0) - cloud.points) * normals).sum(dim=1) >= -1e-6).all()


def test_fpfh_of_a_batch_is_that_of_its_clouds():
    clouds = [sphere_cloud(count, seed=count) for count in (60, 90)]
    empty = clouds[0].rows(torch.zeros(0, dtype=torch.int64), torch.tensor([0, 0]))
    batch = tr.Clouds.pack([clouds[0], empty, clouds[1]])
    together = open3d.fpfh(batch, 0.6, 30)
    assert together.blocks == (("fpfh", 33),)
    assert together.values.dtype == torch.float64
    assert torch.equal(together.offsets, batch.offsets)
    alone = torch.cat([open3d.fpfh(cloud, 0.6, 30).values for cloud in clouds])
    assert torch.equal(together.values, alone)
    assert torch.allclose(alone.sum(dim=1)[together.valid], torch.tensor(600.0, dtype=torch.float64))


def test_fpfh_is_what_open3d_computes():
    o3d = load_open3d()
    cloud = sphere_cloud(60)
    pcd = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points.numpy()))
    pcd.normals = o3d.utility.Vector3dVector(cloud.normals.numpy())
    expected = o3d.pipelines.registration.compute_fpfh_feature(pcd, o3d.geometry.KDTreeSearchParamHybrid(0.6, 30))
    np.testing.assert_array_equal(open3d.fpfh(cloud, 0.6, 30).values.numpy(), np.asarray(expected.data).T)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_neighborhoods_are_those_of_torchreg(dtype):
    cloud = sphere_cloud(300).to(dtype=torch.float32).to(dtype=dtype)
    theirs = open3d.neighborhoods(cloud, 0.4, 12)
    ours = tr.neighbors(cloud.to(dtype=torch.float64), 0.4, 12)
    assert not theirs.valid.all()
    assert torch.equal(theirs.index, ours.index)
    assert torch.equal(theirs.valid, ours.valid)
    assert torch.allclose(theirs.sq_distance, ours.sq_distance, atol=1e-15)


def test_voxel_means_are_those_of_torchreg():
    cloud = moved_origin(room_pair(3000, dtype=torch.float64).source)
    theirs, ours = open3d.voxel_downsample(cloud, 0.3), tr.voxel_downsample(cloud, 0.3)
    assert len(theirs.points) == len(ours.points) < 3000
    assert torch.equal(theirs.origin, UTM)

    def in_order(points):
        return points[np.lexsort(points.numpy().round(6).T)]

    assert torch.allclose(in_order(theirs.points), in_order(ours.points), atol=1e-9)
    assert theirs.colors.shape == theirs.points.shape


@pytest.mark.parametrize("origin", [False, True])
def test_evaluation_is_that_of_torchreg(origin):
    pair = room_pair(2000, seed=4)
    source, target, T = pair.source, pair.target, pair.T_target_source
    if origin:
        source, target = moved_origin(source), moved_origin(target)
        T = T.clone()
        T[:, :3, 3] += UTM[0] - T[0, :3, :3] @ UTM[0]
    source, target, T = tr.Clouds.pack([source, source]), tr.Clouds.pack([target, target]), T.repeat(2, 1, 1)
    T[1, 0, 3] += 0.05
    fit = open3d.evaluate(source, target, T, 0.2)
    assert torch.allclose(fit.fitness, tr.metrics.fitness(source, target, T, 0.2), atol=1e-3)
    assert torch.allclose(fit.inlier_rmse, tr.metrics.inlier_rmse(source, target, T, 0.2), atol=1e-4)
    assert fit.fitness[0] > 0.5
    assert fit.inlier_rmse[0] > 0


def test_an_empty_cloud_covers_nothing():
    cloud = sphere_cloud(50)
    empty = cloud.rows(torch.zeros(0, dtype=torch.int64), torch.tensor([0, 0]))
    T = torch.eye(4, dtype=torch.float64)[None]
    for source, target in ((cloud, empty), (empty, cloud)):
        assert [values.tolist() for values in open3d.evaluate(source, target, T, 0.1)] == [[0], [0]]


def test_what_does_not_fit_is_refused():
    cloud = sphere_cloud(50)
    with refuses("cloud", "normals", "none"):
        open3d.fpfh(tr.Clouds(points=cloud.points), 0.5, 30)
    with refuses("radius", "above 0", "-1"):
        open3d.fpfh(cloud, -1.0, 30)
    with refuses("cloud", "a batch of one", "2 clouds"):
        open3d.neighborhoods(tr.Clouds.pack([cloud, cloud]), 0.5, 30)
    with refuses("threshold", "above 0"):
        open3d.evaluate(cloud, cloud, torch.eye(4, dtype=torch.float64)[None], 0.0)
    with refuses("T_target_source", "(1, 4, 4)"):
        open3d.evaluate(cloud, cloud, torch.eye(4, dtype=torch.float64), 0.1)
