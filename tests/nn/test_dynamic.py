"""Graphs for any number of points: descriptors and the whole of ``Register``, exported and compiled once."""

import pytest
import torch
from closeness import close
from problems import room_pair, sphere_cloud
from refusals import refuses
from torch import nn
from torch.export import Dim

import torchreg as tr
from torchreg.neighborhoods.dense_search import search_dense

# what torch's own compiler does on its way
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.torch.jit.script_method. is deprecated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning"),
]

READS = ("_local_scalar_dense", "item", "nonzero", "masked_select", "unique", "equal")
OPTIONS = tr.RegistrationOptions(
    normal_radius=1.0,
    normal_max_neighbors=12,
    descriptors=(tr.Fpfh(radius=2.0, max_neighbors=16), tr.Pcfh(radius=1.5, max_neighbors=16)),
    solver=tr.RansacOptions(inlier_threshold=0.6),
)


class Described(nn.Module):
    """FPFH and PCFH, side by side, from tensors alone; the colors serve as hue, saturation and value."""

    def __init__(self, **words):
        super().__init__()
        self.geometry, self.color = tr.nn.FPFH(**words), tr.nn.PCFH(**words)

    def forward(self, points, normals, values, index, valid, sq_distance):
        cloud, near = tr.Clouds(points=points, normals=normals), tr.Neighborhoods(index, valid, sq_distance)
        features = self.geometry(cloud, near), self.color(cloud, near, values=values)
        return torch.cat([part.values for part in features], dim=1)


class Registered(nn.Module):
    """``Register`` from tensors alone."""

    def __init__(self, options):
        super().__init__()
        self.register = tr.nn.Register(options)

    def forward(self, source, source_colors, target, target_colors):
        sides = tr.Clouds(source, colors=source_colors), tr.Clouds(target, colors=target_colors)
        return self.register(*sides).T_target_source


def described_tensors(count, seed=0):
    cloud = sphere_cloud(count, seed=seed).to(dtype=torch.float32)
    near = tr.neighbors(cloud, 0.9, 12)
    return cloud.points, cloud.normals, cloud.colors, near.index, near.valid, near.sq_distance


def pair_tensors(count, seed):
    pair = room_pair(count, seed=seed)
    return pair.source.points, pair.source.colors, pair.target.points, pair.target.colors


def reads_of(exported):
    """The operations of a graph that would read a value back to the host."""
    names = [str(node.target) for node in exported.graph.nodes if node.op == "call_function"]
    return [name for name in names if any(f".{read}." in name for read in READS)]


@pytest.mark.parametrize("words", [{}, pytest.param({"binning": "hard"}, marks=pytest.mark.slow)], ids=str)
def test_an_exported_descriptor_takes_any_number_of_points(words):
    module, points = Described(**words), Dim("points", min=16, max=100_000)
    exported = torch.export.export(
        module, described_tensors(40), dynamic_shapes=tuple({0: points} for _ in range(6)), strict=False
    )
    assert reads_of(exported) == []
    for count in (30, 150):
        tensors = described_tensors(count, seed=1)
        assert close(exported.module()(*tensors), module(*tensors), atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("how", [{"fullgraph": True, "dynamic": False}, {}], ids=str)
def test_a_compiled_descriptor_takes_any_number_of_points_and_passes_gradients_on(how):
    module = Described()
    torch._dynamo.reset()
    compiled = torch.compile(module, backend="aot_eager", **how)
    for count in (40, 90, 150):
        tensors = described_tensors(count)
        gradients = []
        for run in (module, compiled):
            leaf = tensors[0].clone().requires_grad_()
            out = run(leaf, *tensors[1:])
            gradients.append(torch.autograd.grad(out.square().mean(), leaf)[0])
        assert close(compiled(*tensors), module(*tensors), atol=1e-3)
        assert close(gradients[1], gradients[0], atol=1e-3 * float(gradients[0].abs().max()))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # the exporter's own
def test_a_soft_descriptor_in_onnx_takes_any_number_of_points(tmp_path):
    pytest.importorskip("onnxscript")
    runtime = pytest.importorskip("onnxruntime")
    module, points = Described(), Dim("points", min=16, max=100_000)
    exported = torch.export.export(
        module, described_tensors(40), dynamic_shapes=tuple({0: points} for _ in range(6)), strict=False
    )
    torch.onnx.export(exported, dynamo=True).save(tmp_path / "described.onnx")
    session = runtime.InferenceSession(tmp_path / "described.onnx")
    for count in (30, 150):
        tensors = described_tensors(count, seed=1)
        given = {each.name: tensor.numpy() for each, tensor in zip(session.get_inputs(), tensors, strict=True)}
        assert close(torch.from_numpy(session.run(None, given)[0]), module(*tensors).detach(), atol=1e-3)


@pytest.mark.slow
def test_an_exported_registration_takes_any_numbers_of_points_and_reads_nothing_back():
    module = Registered(OPTIONS)
    p, q = (Dim(name, min=32, max=20_000) for name in ("p", "q"))
    shapes = ({0: p}, {0: p}, {0: q}, {0: q})
    exported = torch.export.export(module, pair_tensors(200, seed=3), dynamic_shapes=shapes, strict=False)
    assert reads_of(exported) == []
    for count in (150, 500):
        tensors = pair_tensors(count, seed=4)
        assert close(exported.module()(*tensors), module(*tensors), atol=1e-3)


class Searched(nn.Module):
    def forward(self, points):
        near = tr.neighbors(tr.Clouds(points), 0.9, 12)
        return near.index, near.valid, near.sq_distance


def test_the_search_of_a_graph_is_the_search():
    points = sphere_cloud(60).points.float()
    exported = torch.export.export(
        Searched(), (points,), dynamic_shapes=({0: Dim("p", min=13, max=9999)},), strict=False
    )
    assert reads_of(exported) == []
    for count in (25, 200):
        other = sphere_cloud(count, seed=2).points.float()
        expected = tr.neighbors(tr.Clouds(other), 0.9, 12, backend="torch")
        index, valid, square = exported.module()(other)
        assert torch.equal(valid, expected.valid)
        assert torch.equal(square[valid], expected.sq_distance[valid])
        assert torch.equal(index[valid], expected.index[valid])


def test_points_at_equal_distances_keep_their_order():
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]])
    index, valid, square = search_dense(points, 1.5, 3)
    assert index[0].tolist() == [0, 1, 2]
    assert square[0].tolist() == [0, 1, 1]
    assert valid[1].tolist() == [True, True, False]
    assert int(index[1, 2]) == 1


@pytest.mark.parametrize("options", [None, tr.RegistrationOptions(voxel_size=0.5)])
def test_what_no_graph_can_do_is_refused(options):
    with refuses("options", "lengths without voxels, where a graph is captured"):
        torch.export.export(Registered(options), pair_tensors(60, seed=3), strict=False)


class Batch(nn.Module):
    def forward(self, points, offsets):
        return tr.neighbors(tr.Clouds(points, offsets), 1.0, 4).index


def test_a_graph_holds_for_one_cloud():
    with refuses("offsets", "one cloud, where a graph is captured"):
        torch.export.export(Batch(), (torch.rand(20, 3), torch.tensor([0, 8, 20])), strict=False)
