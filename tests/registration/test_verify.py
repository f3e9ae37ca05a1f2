"""``verify``: a given transform is right where it settles, nearby, to the pose that wins; else it is said why not."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from determinism import same_bits, threads
from problems import room_pair, turned
from refusals import refuses
from scenes import FURNISHED, OTHER_ROOM, SYMMETRIC, moved_pair

import torchreg as tr
from torchreg.geometry.se3 import compose, inverse, rigid

EYE = torch.eye(3, dtype=torch.float64)
SIZES = (900, 300, 700)


def shift(x, y=0.0, z=0.0):
    return rigid(EYE, torch.tensor([x, y, z], dtype=torch.float64))


def rms(one, other, cloud):
    """Of the points of a cloud under two transforms, by moving every point."""
    points = cloud.points.double() + cloud.origin[0]
    apart = points @ (one - other)[:3, :3].T + (one - other)[:3, 3]
    return float(apart.square().sum(dim=1).mean().sqrt())


@pytest.fixture(scope="module")
def room():
    """A room like no other: source, target, T_target_source (4, 4)."""
    pair = room_pair(1800, seed=3)
    return pair.source, pair.target, pair.T_target_source[0]


@pytest.fixture(scope="module")
def threshold(room):
    return tr.derive_options(*room[:2])[0].inlier_threshold


@pytest.mark.parametrize("thresholds", [0.0, 0.1, 0.4, -0.7])
def test_a_transform_near_the_right_one_is_right_and_how_far_off_is_told(room, thresholds, threshold):
    source, target, T = room
    meters = thresholds * threshold
    result = tr.verify(source, target, compose(shift(meters), T))
    assert bool(result.success[0])
    assert result.failure == (None,)
    assert float(result.probability[0]) > 0.8
    assert float(result.deviation_meters[0]) == pytest.approx(abs(meters), abs=0.1 * threshold)
    assert rms(result.settled[0], T, source) < 0.1 * threshold
    assert rms(result.settled[0], result.likeliest[0], source) < 0.1 * threshold
    assert rms(result.settled_candidate[0].T_target_source, result.settled[0], source) < 0.1 * threshold
    coarse = tr.verify(source, target, compose(shift(meters), T), refine="none")
    assert torch.equal(coarse.settled_candidate[0].T_target_source, coarse.settled[0])


def test_the_deviation_is_the_distance_that_the_points_move(room):
    source, target, T = room
    given = compose(turned(1.5, axis=(1.0, 2.0, 0.5), translation=(0.04, 0.0, 0.02)), T)
    result = tr.verify(source, target, given)
    assert float(result.deviation_meters[0]) == pytest.approx(rms(given, result.settled[0], result.source), rel=1e-6)
    expected = tr.metrics.rre(given, result.settled[0])
    assert float(result.deviation_degrees[0]) == pytest.approx(float(expected), rel=1e-6)
    assert torch.equal(result.candidate[0].T_target_source, given)


@pytest.mark.parametrize(
    ("wrong", "kind"),
    [
        (shift(0.9), "displaced"),
        (shift(0.0, 0.6, -0.6), "displaced"),
        (shift(10.0), "another pose is better"),
        (turned(180.0), "another pose is better"),
        (turned(90.0, axis=(1.0, 0.0, 0.0)), "another pose is better"),
    ],
)
def test_a_wrong_transform_loses_for_the_true_reason(room, wrong, kind):
    source, target, T = room
    given = compose(wrong, T)
    result = tr.verify(source, target, given)
    assert not bool(result.success[0])
    assert result.failure[0].kind == kind
    assert result.reason[0].startswith(kind)
    assert float(result.probability[0]) < 0.1
    assert rms(result.likeliest[0], T, source) < 0.05  # what would be right is told
    assert bool(result.search.success[0])
    figures = result.failure[0].figures
    told = figures["meters"] if kind == "displaced" else figures["rival_meters"]
    weighed = result.search.candidates[0][0].T_target_source  # before refinement, as the reason was found
    other = result.settled[0] if kind == "displaced" else weighed
    assert told == pytest.approx(rms(given, other, result.source), rel=1e-6)


@pytest.mark.slow
def test_both_poses_of_a_room_that_equals_itself_are_ambiguous():
    source, target, T = moved_pair(SYMMETRIC)
    for given in (T, compose(turned(180.0), T)):
        result = tr.verify(source, target, given)
        assert (bool(result.success[0]), result.failure[0].kind) == (False, "ambiguous")
        assert float(result.probability[0]) < 0.6
    assert tr.register(source, target).failure[0].kind == "ambiguous"
    far = tr.verify(source, target, compose(shift(10.0), T))
    assert far.failure[0].kind == "another pose is better"
    assert far.reason[0].endswith("that pose is not trusted either")


@pytest.mark.slow
def test_between_different_rooms_nothing_is_right():
    source, target, T = moved_pair(FURNISHED, OTHER_ROOM)
    result = tr.verify(source, target, T)
    assert not bool(result.success[0])
    assert not bool(result.search.success[0])


@pytest.mark.parametrize("seed", [3, 5])
def test_what_register_finds_has_the_verdict_of_register(seed):
    source, target, _ = room_pair(700, seed=seed)
    registered = tr.register(source, target)
    result = tr.verify(source, target, registered.T_target_source)
    assert torch.equal(result.success, registered.success)
    torch.testing.assert_close(result.probability, registered.probability, atol=0.02, rtol=0)
    assert float(result.deviation_meters[0]) < 0.01


def test_the_search_goes_on_as_without_a_given_transform(room):
    source, target, T = room
    registered = tr.register(source, target)
    result = tr.verify(source, target, compose(shift(10.0), T))
    assert torch.equal(result.search.T_target_source, registered.T_target_source)
    assert torch.equal(result.search.correspondences.source, registered.correspondences.source)
    assert result.search.stages == registered.stages


def test_the_inverse_is_right_for_swapped_clouds_and_a_moved_frame_changes_nothing(room):
    source, target, T = room
    assert bool(tr.verify(target, source, inverse(T)).success[0])
    utm = shift(512_345.25, 5_412_345.5, 431.125)
    far = tr.verify(tr.transform(source, utm), tr.transform(target, utm), compose(compose(utm, T), inverse(utm)))
    here = tr.verify(source, target, T)
    assert bool(far.success[0])
    torch.testing.assert_close(far.probability, here.probability, atol=0.02, rtol=0)
    assert float(far.deviation_meters[0]) == pytest.approx(float(here.deviation_meters[0]), abs=0.005)


def test_digits_that_a_file_lacks_do_not_matter(room):
    source, target, T = room
    result = tr.verify(source, target, (T * 1e5).round() / 1e5)
    assert bool(result.success[0])
    R = result.settled[0, :3, :3]
    assert float((R @ R.T - EYE).abs().max()) < 1e-12


def test_options_without_competition_are_weighed_all_the_same(room):
    source, target, T = room
    options = tr.derive_options(source, target)[0]
    result = tr.verify(source, target, T, replace(options, effort="plain"))
    assert result.options[0].effort == "balanced"
    assert bool(result.success[0])
    assert tr.verify(source, target, T, options, effort="fast").options[0].effort == "fast"


def mixed():
    """Pairs of all sizes and one that cannot be registered, with transforms of all kinds."""
    pairs = [room_pair(size, seed=size) for size in SIZES]
    single = tr.Clouds(points=torch.zeros(2, 3), colors=torch.zeros(2, 3), viewpoint=torch.zeros(1, 3))
    sources, targets = ([pair[side] for pair in pairs] for side in range(2))
    moves = (shift(0.0), shift(0.9), turned(100.0))
    T = [compose(move, pair.T_target_source[0]) for move, pair in zip(moves, pairs, strict=True)]
    order = (tr.Clouds.pack([sources[0], single, *sources[1:]]), tr.Clouds.pack([targets[0], single, *targets[1:]]))
    return *order, torch.stack([T[0], T[0], *T[1:]])


def test_a_pair_has_the_same_bits_alone_in_a_batch_and_with_any_number_of_threads():
    source, target, T = mixed()
    whole = tr.verify(source, target, T)
    tensors = [name for name, value in vars(whole).items() if isinstance(value, torch.Tensor)]
    for b in range(len(source)):
        alone = tr.verify(source.select(b), target.select(b), T[b])
        for name in tensors:
            assert same_bits(getattr(alone, name), getattr(whole, name)[b : b + 1].clone()), (name, b)
        assert same_bits(alone.search.T_target_source[0], whole.search.T_target_source[b].clone())
        assert alone.failure == whole.failure[b : b + 1]
        assert str(alone.candidate) == str(whole.candidate[b : b + 1])  # NaN as it is
        assert str(alone.settled_candidate) == str(whole.settled_candidate[b : b + 1])
        assert str(alone.rival) == str(whole.rival[b : b + 1])
    for number in (2, 3):
        with threads(number):
            again = tr.verify(source, target, T, max_bytes=1)
        for name in tensors:
            assert same_bits(getattr(again, name), getattr(whole, name)), (name, number)
        assert again.failure == whole.failure


def test_clouds_that_cannot_be_registered_are_data():
    source, target, T = mixed()
    result = tr.verify(source, target, T)
    assert result.failure[1].kind == "too few points"
    assert not bool(result.success[1])
    assert float(result.probability[1]) == 0
    assert result.candidate[1] is None
    assert result.rival[1] is None
    for name in ("settled", "likeliest", "deviation_meters", "deviation_degrees"):
        assert bool(getattr(result, name)[1].isnan().all())
        assert bool(getattr(result, name)[[0, 2, 3]].isfinite().all())
    assert bool(result.success[0])


@pytest.mark.parametrize(
    ("given", "parts"),
    [
        (torch.eye(3), ["(1, 4, 4)", "(3, 3)"]),
        (torch.eye(4).expand(2, 4, 4), ["(1, 4, 4)", "(2, 4, 4)"]),
        ("a.txt", ["(1, 4, 4) numbers", "a.txt"]),
        (torch.full((4, 4), torch.nan), ["finite numbers"]),
        (torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0])), ["a reflection", "determinant -1"]),
        (torch.diag(torch.tensor([1.2, 1.2, 1.2, 1.0])), ["a scale of 1.2", "determinant 1.728"]),
    ],
)
def test_what_is_no_rigid_transform_is_refused(given, parts):
    pair = room_pair(50)
    with refuses("T_target_source", *parts):
        tr.verify(pair.source, pair.target, given)


def test_the_one_that_is_not_rigid_is_named():
    pair = room_pair(50)
    both = (tr.Clouds.pack([cloud, cloud]) for cloud in pair[:2])
    with refuses("T_target_source[1]", "a scale of 2"):
        tr.verify(*both, torch.stack([torch.eye(4), torch.diag(torch.tensor([2.0, 2.0, 2.0, 1.0]))]))
    with refuses("effort", "'plain'"):
        tr.verify(*pair[:2], torch.eye(4), effort="plain")


def test_numbers_from_numpy_and_one_transform_for_all_pairs_will_do(room):
    source, target, T = room
    both = (tr.Clouds.pack([cloud, cloud]) for cloud in (source, target))
    result = tr.verify(*both, T.numpy())
    assert result.T_target_source.shape == (2, 4, 4)
    assert same_bits(result.settled[0].clone(), result.settled[1].clone())
