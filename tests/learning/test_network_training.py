"""Training of a network: what it learns, that it repeats and resumes bit for bit, and the views it learns from."""

import io
from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from determinism import same_bits
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.geometry.se3 import apply
from torchreg.learning import NetworkTraining, NetworkTrainingOptions, PosedPair, load_network
from torchreg.learning.network_training import drawn_network, saved_network
from torchreg.learning.posed_pairs import random_view, whole_view
from torchreg.nn import PointNetwork

VOXEL = 0.25
BRIEF = NetworkTrainingOptions(steps=6, points=200, anchors=64)


def posed(seed=0, group="rooms"):
    room = room_pair(2500, seed=seed)
    pair = tr.datasets.ScanPair(room.source, room.target, room.T_target_source[0], f"room {seed}")
    return PosedPair(pair, group, VOXEL)


@pytest.fixture(scope="module")
def pairs():
    return [posed(0, "a"), posed(1, "b")]


def small():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return PointNetwork(width=16, hidden=32)


def state_of(training):
    """What a file holds of a training."""
    file = io.BytesIO()
    torch.save(training.state_dict(), file)
    file.seek(0)
    return torch.load(file, weights_only=True)


@pytest.mark.slow
def test_it_learns_one_pair(pairs):
    options = NetworkTrainingOptions(steps=60, points=300, rate=3e-3)
    training = NetworkTraining(pairs[:1], options)
    losses = [training.step() for _ in range(options.steps)]
    assert sum(losses[-10:]) < 0.8 * sum(losses[:10])
    held = {"before": drawn_network(0), "after": training.network}
    methods = {name: tr.learning.network_features(network)["network"] for name, network in held.items()}
    ratio = {one.features: one.inlier_ratio for one in tr.learning.match_quality(methods, pairs[:1])}
    assert ratio["after"] > ratio["before"] + 0.05


def test_a_resumed_run_gives_the_bits_of_one_that_never_stopped(pairs):
    whole = NetworkTraining(pairs, BRIEF, network=small())
    losses = [whole.step() for _ in range(6)]
    first = NetworkTraining(pairs, BRIEF, network=small())
    assert [first.step() for _ in range(3)] == losses[:3]
    torch.rand(5)  # the global generator has no say
    resumed = NetworkTraining(pairs, BRIEF, network=small())
    resumed.load_state_dict(state_of(first))
    assert resumed.done == 3
    assert [resumed.step() for _ in range(3)] == losses[3:]
    for one, other in zip(whole.network.parameters(), resumed.network.parameters(), strict=True):
        assert same_bits(one.detach(), other.detach())


def test_training_leaves_the_global_generator_alone(pairs):
    before = torch.get_rng_state()
    NetworkTraining(pairs, BRIEF).step()
    assert torch.equal(torch.get_rng_state(), before)


def test_another_seed_gives_other_weights(pairs):
    runs = [NetworkTraining(pairs, replace(BRIEF, seed=seed), network=small()) for seed in (0, 1)]
    assert runs[0].step() != runs[1].step()


def test_the_rate_rises_and_falls_to_nothing(pairs):
    training = NetworkTraining(pairs, replace(BRIEF, steps=100), network=small())
    rates = []
    for done in range(101):
        training.done = done
        rates.append(training.rate)
    top = rates.index(max(rates))
    assert 1 <= top <= 10
    assert all(a < b for a, b in pairwise(rates[: top + 1]))
    assert all(a > b for a, b in pairwise(rates[top:]))
    assert rates[-1] == pytest.approx(0, abs=1e-12)
    assert 0.9 * BRIEF.rate < max(rates) <= BRIEF.rate


def test_weights_come_back_from_a_file(pairs, tmp_path):
    training = NetworkTraining(pairs, BRIEF, network=small())
    training.step()
    torch.save(saved_network(training), tmp_path / "weights.pt")
    torch.save({"training": training.state_dict()}, tmp_path / "checkpoint.pt")
    side = whole_view(pairs[0]).source
    expected = training.network(side.cloud, side.near).values.detach()
    for name in ("weights.pt", "checkpoint.pt"):
        network = load_network(tmp_path / name)
        assert not network.training
        assert not any(weight.requires_grad for weight in network.parameters())
        assert same_bits(network(side.cloud, side.near).values, expected)


def test_files_of_another_kind_are_refused(tmp_path):
    (tmp_path / "words.pt").write_text("no weights")
    torch.save({"weights": torch.zeros(3)}, tmp_path / "other.pt")
    torch.save([1, 2], tmp_path / "list.pt")
    for name in ("words.pt", "other.pt", "list.pt"):
        with refuses(str(tmp_path / name), "weights written by torchreg train"):
            load_network(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        load_network(tmp_path / "none.pt")


@pytest.mark.parametrize("seed", range(4))
def test_partners_of_a_view_are_the_same_places(pairs, seed):
    """Whatever was changed, one rigid motion takes the partners onto each other."""
    view = random_view(pairs[0], seed, points=300)
    source, target = view.source.cloud, view.target.cloud
    p, q = source.points[view.is_partner].double(), target.points[view.partner[view.is_partner]].double()
    assert len(p) > 30
    T = tr.kabsch(p, q)
    assert (apply(T, p) - q).norm(dim=1).median() < view.voxel
    assert source.normals is not None
    assert view.source.near.radius == pytest.approx(5 * view.voxel)


def test_views_follow_from_their_seed(pairs):
    one, again, other = (random_view(pairs[0], seed, points=200) for seed in (5, 5, 6))
    assert same_bits(one.source.cloud.points, again.source.cloud.points)
    assert same_bits(one.partner, again.partner)
    assert one.source.cloud.points.shape != other.source.cloud.points.shape or not torch.equal(
        one.source.cloud.points, other.source.cloud.points
    )


def test_views_are_about_as_large_as_asked_and_some_have_no_colors(pairs):
    thin = pairs[0].thinned()
    views = [random_view(thin, seed, points=150) for seed in range(12)]
    sizes = [len(side.cloud.points) for view in views for side in (view.source, view.target)]
    assert max(sizes) < 2 * 150
    assert sum(sizes) / len(sizes) > 75
    colored = [view.source.cloud.colors is not None for view in views]
    assert any(colored)
    assert not all(colored)


def test_what_does_not_fit_is_refused(pairs):
    with refuses("pairs", "at least one"):
        NetworkTraining([], BRIEF)
    for name, value in (
        ("steps", 0),
        ("points", 5),
        ("anchors", 1),
        ("rate", 0.0),
        ("temperature", -1.0),
        ("decay", 1.0),
    ):
        with refuses(name):
            NetworkTrainingOptions(**{name: value})
    with refuses("voxel", "above 0"):
        replace(pairs[0], voxel=0.0)
    unknown = replace(pairs[0].pair, T_target_source=torch.full((4, 4), torch.nan, dtype=torch.float64))
    with refuses("pair", "known motion"):
        replace(pairs[0], pair=unknown)


def test_a_state_of_another_run_is_refused(pairs):
    training = NetworkTraining(pairs, BRIEF, network=small())
    with refuses("state", "steps 6", "steps 7"):
        training.load_state_dict(NetworkTraining(pairs, replace(BRIEF, steps=7), network=small()).state_dict())
    with refuses("state", "width 16", "width 64"):
        training.load_state_dict(NetworkTraining(pairs, BRIEF).state_dict())


def test_scans_that_share_nothing_are_refused(pairs):
    far = pairs[0].pair.T_target_source.clone()
    far[:3, 3] += 500
    apart = replace(pairs[0], pair=replace(pairs[0].pair, T_target_source=far))
    with refuses("pairs", "overlap"):
        NetworkTraining([apart], BRIEF, network=small()).step()
