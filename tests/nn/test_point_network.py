"""The network: what it maps to what, and what must not change its features."""

import json
from dataclasses import replace

import pytest
import torch
from closeness import close
from problems import garbage_in_invalid_slots, oriented_room, random_transform, room_pair, seeded, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.io.result_json import plain_data
from torchreg.learning.network_training import drawn_network
from torchreg.nn import NetworkBlock, PointNetwork

CLOUD = sphere_cloud(120)
NEAR = tr.neighbors(CLOUD, 0.8, 30)


@pytest.fixture(scope="module")
def network():
    return drawn_network(0).double()


def test_features_are_unit_rows_of_one_block(network):
    features = network(CLOUD, NEAR)
    assert features.blocks == (("network", 32),)
    assert features.values.dtype == CLOUD.points.dtype
    assert torch.equal(features.offsets, CLOUD.offsets)
    assert features.valid.all()
    assert close(features.values.norm(dim=1), torch.ones(120, dtype=torch.float64), atol=1e-9)
    assert features.values.std(dim=0).min() > 0.01  # points differ


def test_sizes_make_the_same_network_again():
    network = PointNetwork(features=7, width=5, hidden=6, layers=3, stride=2)
    assert network(CLOUD, NEAR).values.shape == (120, 7)
    again = PointNetwork(**network.sizes())
    again.load_state_dict(network.state_dict())
    assert again.sizes() == network.sizes()


def test_the_usual_network_has_as_many_weights_as_it_says():
    assert f"{sum(weight.numel() for weight in PointNetwork().parameters()):,} weights" in PointNetwork.__doc__


@pytest.mark.parametrize("seed", range(3))
def test_rigid_motion_changes_nothing(network, seed):
    moved = tr.transform(CLOUD, random_transform(seeded(seed)))
    again = network(moved, tr.neighbors(moved, 0.8, 30))
    assert close(again.values, network(CLOUD, NEAR).values, atol=1e-9)


def test_scale_changes_nothing_where_supports_scale_too(network):
    larger = replace(CLOUD, points=3 * CLOUD.points)
    assert close(network(larger, tr.neighbors(larger, 2.4, 30)).values, network(CLOUD, NEAR).values, atol=1e-9)


def test_a_mirror_image_is_another_shape(network):
    mirror = torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
    image = replace(CLOUD, points=CLOUD.points * mirror, normals=CLOUD.normals * mirror)
    apart = (network(image, NEAR).values - network(CLOUD, NEAR).values).norm(dim=1)
    assert apart.median() > 1e-3


def test_order_of_points_does_not_matter(network):
    order = torch.randperm(120, generator=seeded(1))
    shuffled = CLOUD.rows(order, CLOUD.offsets)
    again = network(shuffled, tr.neighbors(shuffled, 0.8, 30))
    assert close(again.values, network(CLOUD, NEAR).values[order], atol=1e-9)


@pytest.mark.parametrize("given", [True, False])
def test_a_batch_is_its_clouds_one_by_one(network, given):
    larger = sphere_cloud(80, seed=2)
    clouds = [CLOUD, replace(larger, points=2 * larger.points)]
    radii = [0.8, 1.6]
    batch = tr.Clouds.pack(clouds)
    near = tr.neighbors(batch, torch.tensor(radii, dtype=torch.float64), 30) if given else None
    alone = [
        network(cloud, tr.neighbors(cloud, radius, 30) if given else None)
        for cloud, radius in zip(clouds, radii, strict=True)
    ]
    found = network(batch, near)
    assert torch.equal(found.offsets, batch.offsets)
    assert close(found.values, torch.cat([one.values for one in alone]), atol=1e-9)


def test_pieces_do_not_show(network, monkeypatch):
    expected = network(CLOUD, NEAR).values
    monkeypatch.setattr("torchreg.nn.point_network._CHUNK", 1000)
    assert close(network(CLOUD, NEAR).values, expected, atol=1e-12)


def test_garbage_in_invalid_slots_changes_nothing(network):
    near = tr.neighbors(CLOUD, 0.4, 30)
    assert not near.valid.all()
    assert torch.equal(network(CLOUD, garbage_in_invalid_slots(near)).values, network(CLOUD, near).values)


def test_color_counts_where_there_is_any(network):
    other = replace(CLOUD, colors=CLOUD.colors.flip(0))
    plain = replace(CLOUD, colors=None)
    features = [network(cloud, NEAR) for cloud in (CLOUD, other, plain)]
    for one, two in ((0, 1), (0, 2)):
        assert (features[one].values - features[two].values).norm(dim=1).median() > 1e-3
    assert features[2].valid.all()


def test_normals_and_supports_are_found_where_they_are_missing():
    room, _ = oriented_room(600)
    spacing = float(tr.spacing(room))
    near = tr.neighbors(room, 5 * spacing, 100)
    bare = replace(room, normals=None)
    oriented = tr.estimate_normals(bare, near.restrict(2 * spacing, 30))
    network = drawn_network(1)
    assert torch.equal(network(bare).values, network(oriented, near).values)


def test_gradients_flow_to_weights_points_normals_and_colors():
    leaves = [value.clone().requires_grad_() for value in (CLOUD.points, CLOUD.normals, CLOUD.colors)]
    cloud = replace(CLOUD, points=leaves[0], normals=leaves[1], colors=leaves[2])
    network = drawn_network(0).double()
    values = network(cloud, NEAR).values
    (values * torch.randn(values.shape, generator=seeded(3), dtype=torch.float64)).sum().backward()
    for leaf in (*leaves, *network.parameters()):
        assert torch.isfinite(leaf.grad).all()
        assert leaf.grad.abs().sum() > 0


def test_gradients_are_finite_for_coincident_points_and_gray_colors():
    points = torch.cat([CLOUD.points[:60], CLOUD.points[:60]]).requires_grad_()
    gray = torch.zeros_like(CLOUD.colors).requires_grad_()
    cloud = replace(CLOUD, points=points, colors=gray)
    network = drawn_network(0).double()
    network(cloud, tr.neighbors(cloud, 0.8, 30)).values.square().sum().backward()
    for leaf in (points, gray, *network.parameters()):
        assert torch.isfinite(leaf.grad).all()


def test_a_lonely_point_describes_nothing(network):
    points = torch.cat([CLOUD.points, torch.full((1, 3), 50.0, dtype=torch.float64)])
    colors, normals = (torch.cat([rows, rows[:1]]) for rows in (CLOUD.colors, CLOUD.normals))
    cloud = tr.Clouds(points=points, colors=colors, normals=normals)
    features = network(cloud, tr.neighbors(cloud, 0.8, 30))
    assert features.valid.tolist() == [True] * 120 + [False]
    assert not features.values[-1].any()


def test_no_points_have_no_features(network):
    empty = tr.Clouds(points=torch.zeros(0, 3, dtype=torch.float64), normals=torch.zeros(0, 3, dtype=torch.float64))
    assert network(empty).values.shape == (0, 32)


def test_what_does_not_fit_is_refused(network):
    with refuses("near", "120 points"):
        network(CLOUD, tr.neighbors(sphere_cloud(30), 0.8, 10))
    with refuses("near", "radius"):
        network(CLOUD, replace(NEAR, radius=None))
    for name in ("features", "width", "hidden", "layers", "stride"):
        with refuses(name, "0"):
            PointNetwork(**{name: 0})


def test_as_a_block_it_registers_beside_the_defaults():
    room = room_pair(3000, seed=1)
    spacing = float(tr.spacing(room.source))
    options = tr.options_for(spacing)
    block = NetworkBlock(network=drawn_network(0), radius=5 * spacing)
    options = replace(options, descriptors=(*options.descriptors, block), weights=(*options.weights, 1.0))
    result = tr.register(room.source, room.target, options)
    assert bool(result.success[0])
    assert float(tr.metrics.rre(room.T_target_source, result.T_target_source)) < 3
    assert options.scaled(2.0).descriptors[-1] == replace(block, radius=10 * spacing)


def test_a_block_states_how_far_it_sees():
    """Within the reach a point moves a row, beyond it none."""
    block = NetworkBlock(network=drawn_network(0).double(), radius=0.3)
    line = torch.linspace(0, 6, 400, dtype=torch.float64)
    points = torch.stack([line, 0.1 * torch.sin(9 * line), 0.1 * torch.cos(7 * line)], dim=1)
    normals = torch.nn.functional.normalize(torch.rand(400, 3, generator=seeded(0), dtype=torch.float64), dim=1)
    cloud = tr.Clouds(points=points, normals=normals)
    turned = replace(cloud, normals=torch.cat([normals[:-1], -normals[-1:]]))
    rows = [block.describe(each, tr.neighbors(each, 0.3, 100)).values for each in (cloud, turned)]
    changed = (rows[0] - rows[1]).abs().amax(dim=1) > 0
    away = (points[-1] - points).norm(dim=1)
    assert block.reach == pytest.approx(1.2)
    assert away[changed].max() < block.reach
    assert away[changed].max() > 0.6 * block.reach


def test_a_block_is_saved_as_numbers_and_said_in_json(tmp_path):
    block = NetworkBlock(network=drawn_network(3), radius=0.3)
    torch.save(block, tmp_path / "block.pt")
    loaded = torch.load(tmp_path / "block.pt", weights_only=True)
    assert loaded.radius == block.radius
    assert_same_weights(loaded.network, block.network)
    said, other = (plain_data(NetworkBlock(network=drawn_network(seed), radius=0.3)) for seed in (3, 4))
    assert json.loads(json.dumps(said)) == plain_data(block) == plain_data(loaded)
    assert said != other


def assert_same_weights(one, other):
    for left, right in zip(one.state_dict().values(), other.state_dict().values(), strict=True):
        assert torch.equal(left, right)
