"""Descriptors as one graph of plain operations: exported, saved and loaded, and compiled whole."""

import io

import pytest
import torch
from closeness import close
from problems import sphere_cloud
from torch import nn

import torchreg as tr

# what torch's own compiler does on its way
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.torch.jit.script_method. is deprecated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning"),
]

CLOUD = sphere_cloud(40).to(dtype=torch.float32)
NEAR = tr.neighbors(CLOUD, 0.9, 12)
TENSORS = (CLOUD.points, CLOUD.normals, CLOUD.colors, NEAR.index, NEAR.valid, NEAR.sq_distance)


class Described(nn.Module):
    """FPFH and PCFH, side by side, from tensors alone; the colors serve as hue, saturation and value."""

    def __init__(self, **words):
        super().__init__()
        self.geometry, self.color = tr.nn.FPFH(**words), tr.nn.PCFH(**words)

    def forward(self, points, normals, values, index, valid, sq_distance):
        cloud = tr.Clouds(points=points, normals=normals)
        near = tr.Neighborhoods(index, valid, sq_distance)
        features = self.geometry(cloud, near), self.color(cloud, near, values=values)
        return torch.cat([part.values for part in features], dim=1)


EDGES = {"learn_edges": True}
HARD = {"binning": "hard"}


@pytest.mark.parametrize("words", [{}, HARD, pytest.param(EDGES, marks=pytest.mark.slow)], ids=str)
def test_an_exported_descriptor_gives_the_same_numbers_for_other_clouds_after_a_file(words):
    module, file = Described(**words), io.BytesIO()
    torch.export.save(torch.export.export(module, TENSORS, strict=False), file)
    file.seek(0)
    loaded = torch.export.load(file).module()
    other = sphere_cloud(40, seed=1).to(dtype=torch.float32)
    near = tr.neighbors(other, 0.8, 12)
    tensors = (other.points, other.normals, other.colors, near.index, near.valid, near.sq_distance)
    assert close(loaded(*tensors), module(*tensors), atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("words", [{}, HARD, EDGES], ids=str)
def test_a_whole_descriptor_is_one_graph(words):
    module = Described(**words)
    torch._dynamo.reset()
    compiled = torch.compile(module, fullgraph=True, backend="aot_eager")
    assert close(compiled(*TENSORS), module(*TENSORS), atol=1e-3)
