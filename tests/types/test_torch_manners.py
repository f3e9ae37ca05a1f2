"""What PyTorch does with these types: collate, map over a batch, export; and what is said of bare tensors."""

import io

import pytest
import torch
from determinism import same_bits
from made import BATCHES, cloud
from problems import random_points, seeded
from torch.utils import _pytree as pytree
from torch.utils.data import DataLoader, default_collate

import torchreg as tr
from torchreg.datasets import ScanPair, pack_pairs

PAIR = ScanPair(cloud(0), cloud(1), torch.eye(4, dtype=torch.float64), "a pair")


def test_the_default_collate_names_what_packs_pairs():
    with pytest.raises(TypeError, match=r"^collate_fn: expected torchreg\.datasets\.pack_pairs, .* got PyTorch's"):
        next(iter(DataLoader([PAIR, PAIR], batch_size=2)))
    batch = next(iter(DataLoader([PAIR, PAIR], batch_size=2, collate_fn=pack_pairs)))
    assert same_bits(tuple(batch.unpack()), (PAIR, PAIR))


@pytest.mark.parametrize("kind", BATCHES, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("inside", [lambda one: one, lambda one: (one, 1), lambda one: {"one": one}])
def test_the_default_collate_names_what_packs_each_type(kind, inside):
    items = [inside(BATCHES[kind](seed)) for seed in range(2)]
    with pytest.raises(
        TypeError, match=rf"^collate_fn: expected {kind.__name__}\.pack, .* got PyTorch's default_collate"
    ):
        default_collate(items)


def test_equal_clouds_can_be_stacked_and_mapped_over():
    clouds = [tr.Clouds(random_points(9, seed)) for seed in range(4)]
    stacked = pytree.tree_map(lambda *leaves: torch.stack(leaves), *clouds)

    def spread(one):
        assert "points" in repr(one)
        return (one.points - one.points.mean(dim=0)).square().sum()

    expected = torch.stack([spread(one) for one in clouds])
    torch.testing.assert_close(torch.vmap(spread)(stacked), expected)
    by_each = torch.vmap(torch.func.grad(lambda points, one: (points * one.points).sum()), in_dims=0)
    torch.testing.assert_close(by_each(stacked.points, stacked), stacked.points)


class Points(torch.nn.Module):
    def forward(self, clouds):
        return clouds.points - clouds.points.mean(dim=0), clouds.colors.sum(dim=1)


@pytest.mark.parametrize("strict", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore:.*:DeprecationWarning")  # what torch's own compiler does on its way
def test_clouds_go_into_and_come_out_of_an_exported_graph_of_any_number_of_points(strict):
    def colored(count):
        return tr.Clouds(random_points(count), colors=torch.rand(count, 3, generator=seeded(count)))

    module, file = Points(), io.BytesIO()
    rows = {0: torch.export.Dim("rows", min=2)}
    shapes = ([rows, {}, rows, {}, {}],)  # of points, offsets, colors, origin and whether viewpoints are assumed
    torch.export.save(torch.export.export(module, (colored(9),), dynamic_shapes=shapes, strict=strict), file)
    file.seek(0)
    other = colored(23)
    assert same_bits(torch.export.load(file).module()(other), module(other))


POINTS = random_points(20)


@pytest.mark.parametrize(
    ("given", "parts"),
    [
        (POINTS, ["Clouds(points) of points (P, 3) in meters", "a tensor (20, 3) float32 on cpu"]),
        (POINTS.numpy(), ["from_numpy(points)", "an array (20, 3) float32"]),
        ([POINTS], ["Clouds.from_list(points) of tensors (P, 3)", "(list)"]),
        ("a.ply", ["read_cloud(path)", "got 'a.ply'"]),
        (PAIR, ["expected Clouds", "got ScanPair"]),
        (None, ["expected Clouds", "got None"]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_register_says_what_it_takes(given, parts):
    for name, pair in (("source", (given, tr.Clouds(POINTS))), ("target", (tr.Clouds(POINTS), given))):
        with pytest.raises(TypeError, match=rf"^{name}: expected Clouds, such as .*, got ") as caught:
            tr.register(*pair)
        assert all(part in str(caught.value) for part in parts), str(caught.value)


def test_results_of_icp_and_of_registration_speak_alike():
    source = tr.Clouds.pack([tr.Clouds(POINTS), tr.Clouds(POINTS), tr.Clouds(POINTS[:0])])
    moved = tr.Clouds.pack([tr.Clouds(POINTS + 0.01), tr.Clouds(POINTS + 100), tr.Clouds(POINTS)])
    refined = tr.icp(source, moved, torch.eye(4, dtype=torch.float64), tr.IcpOptions(max_distance=0.1))
    registered = tr.register(source, moved, tr.options_for(0.1), refine="none")
    assert isinstance(refined, tr.IcpResult)
    for result in (refined, registered):
        assert result.T_target_source.shape == (3, 4, 4)
        assert result.success.dtype == torch.bool
        assert [failure is None for failure in result.failure] == result.success.tolist()
        assert list(result.reason) == ["" if failure is None else failure.text for failure in result.failure]
        assert len(result[result.success]) == int(result.success.sum())
    assert [failure and failure.kind for failure in refined.failure] == [None, "no correspondences", "too few points"]
