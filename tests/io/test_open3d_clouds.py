"""To Open3D and back; nothing of Open3D is loaded before it is needed."""

import builtins
import subprocess
import sys

import numpy as np
import pytest
import torch
from determinism import same_bits

from torchreg import open3d_loader
from torchreg.io import from_open3d, to_open3d
from torchreg.open3d_loader import load_open3d
from torchreg.types import Clouds

UTM = np.array([512345.0, 5234567.0, 431.0])


def arrays(count=30, seed=0):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    points, colors = rng.uniform(-8, 8, (count, 3)), rng.uniform(0, 1, (count, 3))
    return points, colors, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def legacy(points, colors=None, normals=None):
    o3d = load_open3d()
    pcd = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    if colors is not None:
        pcd.colors = o3d.utility.Vector3dVector(colors)
    if normals is not None:
        pcd.normals = o3d.utility.Vector3dVector(normals)
    return pcd


@pytest.mark.parametrize("shift", [np.zeros(3), UTM])
def test_there_and_back(shift):
    points, colors, normals = arrays()
    cloud = from_open3d(legacy(points + shift, colors, normals))
    assert cloud.points.dtype == torch.float32
    back = to_open3d(cloud)
    np.testing.assert_allclose(np.asarray(back.points), points + shift, atol=1e-6, rtol=0)
    np.testing.assert_allclose(np.asarray(back.colors), colors, atol=1e-7)
    np.testing.assert_allclose(np.asarray(back.normals), normals, atol=1e-6)
    assert (cloud.viewpoint is None) == bool(shift.any())
    assert cloud.viewpoint_assumed.tolist() == [not shift.any()]
    assert from_open3d(legacy(points + shift), "origin").viewpoint_known.tolist() == [True]


def test_a_bare_cloud_in_float64_is_exact():
    points, _, _ = arrays()
    cloud = from_open3d(legacy(points), dtype=torch.float64)
    np.testing.assert_array_equal(cloud.points.numpy(), points)
    assert cloud.colors is None
    assert cloud.normals is None
    back = to_open3d(cloud)
    np.testing.assert_array_equal(np.asarray(back.points), points)
    assert not back.has_colors()
    assert not back.has_normals()


@pytest.mark.parametrize(("dtype", "scale"), [("u1", 255), ("u2", 65535), ("f4", 1)])
def test_tensor_clouds(dtype, scale):
    o3d = load_open3d()
    points, colors, normals = arrays()
    colors = np.round(colors * scale).astype(dtype) if scale > 1 else colors.astype(dtype)
    pcd = o3d.t.geometry.PointCloud(o3d.core.Tensor(points.astype("f4")))
    pcd.point.colors = o3d.core.Tensor(colors)
    pcd.point.normals = o3d.core.Tensor(normals.astype("f4"))
    cloud = from_open3d(pcd, viewpoint=(1, 2, 3))
    np.testing.assert_array_equal(cloud.points.numpy(), points.astype("f4"))
    np.testing.assert_allclose(cloud.colors.numpy(), colors / np.float64(scale), atol=1e-7)
    np.testing.assert_allclose(cloud.normals.numpy(), normals, atol=1e-6)
    assert cloud.viewpoint.tolist() == [[1, 2, 3]]
    assert cloud.viewpoint_known.tolist() == [True]


def test_the_result_does_not_share_memory_with_open3d():
    pcd = legacy(arrays()[0])
    cloud = from_open3d(pcd, dtype=torch.float64)
    before = cloud.points.clone()
    np.asarray(pcd.points)[:] = 0
    assert torch.equal(cloud.points, before)


def test_refused():
    o3d = load_open3d()
    with pytest.raises(ValueError, match=r"^pcd: expected at least one point, got "):
        from_open3d(o3d.geometry.PointCloud())
    with pytest.raises(ValueError, match=r"^pcd: expected at least one point, got "):
        from_open3d(o3d.t.geometry.PointCloud())
    with pytest.raises(ValueError, match=r"^pcd: expected an Open3D point cloud, got "):
        from_open3d(np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"^pcd: expected finite points, got 1 of 2 with NaN"):
        from_open3d(legacy(np.array([[0, 0, 0], [0, np.nan, 0]])))
    with pytest.raises(ValueError, match=r"^pcd: expected colors from 0 to 1, or of 8 or 16 bits, got "):
        from_open3d(legacy(np.eye(3), colors=np.eye(3) * 2))
    with pytest.raises(ValueError, match=r"^viewpoint: expected "):
        from_open3d(legacy(np.eye(3)), viewpoint="here")
    with pytest.raises(ValueError, match=r"^cloud: expected a batch of one"):
        to_open3d(Clouds(torch.rand(4, 3), offsets=torch.tensor([0, 2, 4])))


def test_nothing_heavy_is_imported_with_the_package():
    code = (
        "import sys, torchreg.io, torchreg.open3d_loader\n"
        "assert not {'open3d', 'kornia', 'libusb_package'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_missing_open3d_says_what_to_install(monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name == "open3d":
            raise ImportError("No module named 'open3d'")
        return real(name, *rest)

    open3d_loader.load_open3d.cache_clear()
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r"No module named 'open3d'.*pip install 'open3d>=0.19'"):
        load_open3d()
    monkeypatch.undo()
    assert load_open3d() is load_open3d()


@pytest.mark.parametrize("shift", [np.zeros(3), UTM])
def test_a_tensor_cloud_there_and_back(shift):
    points, colors, normals = arrays()
    cloud = from_open3d(legacy(points + shift, colors, normals))
    made = to_open3d(cloud, tensor=True)
    assert hasattr(made, "point")
    np.testing.assert_allclose(made.point["positions"].numpy(), points + shift, atol=1e-6, rtol=0)
    assert same_bits(from_open3d(made), cloud)
    assert list(to_open3d(Clouds(torch.from_numpy(points)), tensor=True).point) == ["positions"]
