"""To and from other libraries, by small stand-ins with the attributes and methods of the real classes."""

import numpy as np
import pytest
import torch
from determinism import same_bits
from hypothesis import given
from hypothesis import strategies as st
from problems import seeded
from refusals import refuses

import torchreg as tr

UTM = torch.tensor([[512345.5, 5234567.25, 431.0]], dtype=torch.float64)


class Pointclouds:
    """What is used of ``pytorch3d.structures.Pointclouds`` made of lists."""

    def __init__(self, points, normals=None, features=None):
        assert all(rows is None or isinstance(rows, list) for rows in (points, normals, features))
        self._points, self._normals, self._features = points, normals, features

    def points_list(self):
        return self._points

    def normals_list(self):
        return self._normals

    def features_list(self):
        return self._features


class Data:
    """What is used of ``torch_geometric.data.Data``, whose own attributes are ``None`` where they were not given."""

    def __init__(self, pos=None, **others):
        self.pos = pos
        for name, value in others.items():
            assert value is not None
            setattr(self, name, value)


def clouds_of(lengths, colors, normals, far=False):
    generator = seeded(sum(lengths))
    parts = [[torch.rand(length, 3, generator=generator) for length in lengths] for _ in range(3)]
    made = tr.Clouds.from_list(parts[0], parts[1] if colors else None, parts[2] if normals else None)
    return tr.Clouds(made.points, made.offsets, made.colors, made.normals, UTM.repeat(len(lengths), 1)) if far else made


batches = st.builds(clouds_of, st.lists(st.integers(0, 5), min_size=1, max_size=4), st.booleans(), st.booleans())


@given(batches)
def test_to_pytorch3d_and_back(clouds):
    assert same_bits(tr.from_pytorch3d(tr.to_pytorch3d(clouds, Pointclouds)), clouds)


@given(batches)
def test_to_pytorch_geometric_and_back(clouds):
    data = tr.to_pyg(clouds, Data)
    assert hasattr(data, "batch") == hasattr(data, "ptr") == (len(clouds) > 1)
    assert same_bits(tr.from_pyg(data), clouds)


def test_a_batch_is_split_by_its_pointers_or_else_by_its_numbers():
    clouds = clouds_of([3, 0, 2], True, True)
    data = tr.to_pyg(clouds, Data)
    assert data.batch.tolist() == [0, 0, 0, 2, 2]
    assert data.ptr.tolist() == [0, 3, 3, 5]
    del data.ptr
    assert same_bits(tr.from_pyg(data), clouds)
    data.batch = torch.tensor([0, 1, 0, 1, 1])
    with refuses("data.batch", "ascend"):
        tr.from_pyg(data)
    data.ptr = torch.tensor([0, 4])
    with refuses("data.ptr", "from 0 to 5", "[0, 4]"):
        tr.from_pyg(data)


@pytest.mark.parametrize("there", ["points_list", "pos"])
def test_far_origins_lose_nothing_on_the_way_out(there):
    clouds = clouds_of([3, 2], True, True, far=True)
    ways = {
        "points_list": lambda: torch.cat(tr.to_pytorch3d(clouds, Pointclouds).points_list()),
        "pos": lambda: tr.to_pyg(clouds, Data).pos,
    }
    points = ways[there]()
    assert points.dtype == torch.float64
    assert torch.equal(points, clouds.points.double() + UTM)


def test_other_names_and_bytes_of_colors():
    shown = torch.tensor([[0, 51, 255]], dtype=torch.uint8)
    data = Data(torch.zeros(1, 3), rgb=shown, norm=torch.eye(3)[:1])
    cloud = tr.from_pyg(data, colors="rgb", normals="norm")
    torch.testing.assert_close(cloud.colors, torch.tensor([[0.0, 0.2, 1.0]]))
    assert torch.equal(cloud.normals, torch.eye(3)[:1])
    assert tr.from_pyg(data).colors is None
    assert tr.from_pyg(data, colors=None, normals=None).normals is None


def test_gradients_flow_to_and_from_libraries():
    points = torch.rand(4, 3, requires_grad=True)
    for made in (tr.from_pytorch3d(Pointclouds([points])), tr.from_pyg(tr.to_pyg(tr.Clouds(points), Data))):
        assert torch.equal(torch.autograd.grad(made.points.sum(), points)[0], torch.ones(4, 3))


def test_what_is_not_of_a_library_is_refused():
    for other in (torch.zeros(2, 3), tr.Clouds(torch.zeros(2, 3)), None):
        with refuses("clouds", "Pointclouds of PyTorch3D"):
            tr.from_pytorch3d(other)
        with refuses("data", "PyTorch Geometric with pos"):
            tr.from_pyg(other)
    described = Pointclouds([torch.zeros(2, 3)], features=[torch.zeros(2, 32)])
    with refuses("clouds", "features of 3 columns", "(2, 32)"):
        tr.from_pytorch3d(described)
    assert tr.from_pytorch3d(described, colors=False).colors is None
    with refuses("data.pos", "(P, 3)", "(2, 2)"):
        tr.from_pyg(Data(torch.zeros(2, 2)))
    with refuses("data.color", "(2, 3)", "(1, 3)"):
        tr.from_pyg(Data(torch.zeros(2, 3), color=torch.zeros(1, 3)))


def arrays(count=30, seed=0):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    return rng.uniform(-8, 8, (count, 3)), rng.uniform(0, 1, (count, 3)), 3 * normals


@pytest.mark.parametrize("shift", [np.zeros(3), UTM.numpy()[0]])
def test_to_numpy_and_back(shift):
    points, colors, normals = arrays()
    cloud = tr.from_numpy(points + shift, colors, normals)
    back = tr.to_numpy(cloud)
    np.testing.assert_allclose(back.points, points + shift, atol=1e-6, rtol=0)
    np.testing.assert_allclose(back.colors, colors, atol=1e-7)
    np.testing.assert_allclose(back.normals, normals / np.linalg.norm(normals, axis=1, keepdims=True), atol=1e-6)
    assert back.points.dtype == np.float64
    assert bool(cloud.origin.any()) == bool(shift.any())


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colors_of_8_and_16_bits_are_scaled(dtype):
    points, colors, _ = arrays()
    most = np.iinfo(dtype).max
    cloud = tr.from_numpy(points.astype(np.float32), (colors * most).astype(dtype))
    np.testing.assert_allclose(tr.to_numpy(cloud).colors, colors, atol=1.01 / most)


def test_lists_are_arrays_too_and_what_does_not_fit_is_refused():
    assert tr.from_numpy([[0, 0, 1], [1, 2, 3]]).points.tolist() == [[0, 0, 1], [1, 2, 3]]
    points, colors, normals = arrays()
    with refuses("points", "points (N, 3)", "(30, 2)"):
        tr.from_numpy(points[:, :2])
    with refuses("points", "colors (N, 3)", "(29, 3)"):
        tr.from_numpy(points, colors[1:])
    with refuses("points", "normals (N, 3)", "(3,)"):
        tr.from_numpy(points, colors, normals[0])
    with refuses("points", "real numbers", "<U"):
        tr.from_numpy(points.astype(str))
    with refuses("points", "at least one point"):
        tr.from_numpy(points[:0])
    with refuses("points", "finite points", "1 of 30"):
        tr.from_numpy(np.where(np.arange(30)[:, None] == 3, np.nan, points))
    with refuses("points", "colors from 0 to 1"):
        tr.from_numpy(points, colors - 2)
    with refuses("cloud", "a batch of one", "2 clouds"):
        tr.to_numpy(clouds_of([1, 2], False, False))
