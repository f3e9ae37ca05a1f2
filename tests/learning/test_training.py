"""Training of the color model: starts at the plain rule, learns what can be learned, the same bits every time."""

import pytest
import torch
from closeness import close
from determinism import same_bits
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.learned import LearnedColor
from torchreg.learning.prepared import cropped, prepare_pair
from torchreg.learning.training import TrainingOptions, describe_with, train_color

VOXEL = 0.25
BRIEF = TrainingOptions(steps=6, anchors=128, max_points=400)


@pytest.fixture(scope="module")
def pairs():
    made = [room_pair(1500, seed=seed) for seed in range(2)]
    return [
        prepare_pair(room.source, room.target, room.T_target_source[0], VOXEL, name=f"room {i}", scene=f"{i}")
        for i, room in enumerate(made)
    ]


def model(seed=0):
    torch.manual_seed(seed)
    return LearnedColor()


def test_an_untrained_model_without_roots_is_the_plain_rule_with_soft_bins(pairs):
    side, radius = pairs[0].source, 2 * VOXEL
    fresh = model()
    with torch.no_grad():
        fresh.root_logits.fill_(-40.0)
    color = tr.pcfh(
        side.cloud,
        side.near.restrict(radius),
        channels=("hue", "saturation", "value"),
        equalization="none",
        binning="soft",
    )
    plain = tr.fuse(side.fpfh, color)
    found = describe_with(fresh, side, radius)
    assert found.blocks == (("fpfh", 33), ("learned", 33))
    assert close(found.values.detach(), plain.values, atol=1e-5)


def test_every_parameter_gets_a_finite_gradient(pairs):
    fresh = model()
    torch.nn.init.normal_(fresh.weight_layer.weight)
    values = describe_with(fresh, pairs[0].source, 2 * VOXEL).values
    (values * torch.randn(values.shape, generator=torch.Generator().manual_seed(0))).sum().backward()
    for name, parameter in fresh.named_parameters():
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().sum() > 0, name


def test_training_lowers_the_loss_and_repeats_bit_for_bit(pairs):
    options = TrainingOptions(steps=30, anchors=128, max_points=400)
    one, other = model(), model()
    losses = train_color(one, pairs[:1], options)
    assert sum(losses[-5:]) < sum(losses[:5])
    assert train_color(other, pairs[:1], options) == losses
    for left, right in zip(one.state_dict().values(), other.state_dict().values(), strict=True):
        assert same_bits(left, right)


def test_edges_stay_ascending_from_zero_to_one(pairs):
    trained = model()
    train_color(trained, pairs, BRIEF)
    edges = trained.edges().detach()
    assert edges.diff(dim=1).min() > 0
    assert torch.equal(edges[:, 0], torch.zeros(3))
    assert close(edges[:, -1], torch.ones(3), atol=1e-6)


def test_a_crop_keeps_a_place_that_both_scans_saw(pairs):
    part = cropped(pairs[0], 200, torch.Generator().manual_seed(0))
    assert len(part.source.cloud.points) == len(part.target.cloud.points) == 200
    _, close_ = part.true_partners(2 * VOXEL)
    assert close_.float().mean() > 0.3
    assert cropped(pairs[0], 10**6, torch.Generator()) is pairs[0]


def test_what_does_not_fit_is_refused(pairs):
    with refuses("pairs", "at least one"):
        train_color(model(), [])
    with refuses("steps", "0"):
        TrainingOptions(steps=0)
    with refuses("channels", "'hue'", "'green'"):
        LearnedColor(channels=("green",))
    plain = room_pair(100).source
    with refuses("cloud", "colors"):
        prepare_pair(
            tr.Clouds(points=plain.points), plain, torch.eye(4, dtype=torch.float64), VOXEL, name="a", scene="b"
        )
