"""PCFH against the paper's equations by loops, its invariances, and that nothing but the neighborhood shows."""

import oracles
import pytest
import torch
from closeness import close
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import random_transform, room_pair, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.color import color_values, joint_color_values
from torchreg.descriptors.pcfh import difference_bins

CHANNELS = ("hue", "saturation", "value")


def star(*hues, own=0.0, saturation=1.0, dtype=torch.float64):
    """A point with neighbors of these hues all around it at 1 m: cloud, neighborhoods and values."""
    count = 1 + len(hues)
    points = torch.zeros(count, 3, dtype=dtype)
    angle = torch.arange(count - 1, dtype=dtype) / max(1, count - 1) * 6.28
    points[1:] = torch.stack([angle.cos(), angle.sin(), torch.zeros_like(angle)], dim=1)
    values = torch.full((count, 3), saturation, dtype=dtype)
    values[:, 0] = torch.tensor([own, *hues], dtype=dtype)
    cloud = tr.Clouds(points=points)
    return cloud, tr.neighbors(cloud, 1.5, count), values


def hhd_of_center(cloud, near, values, **options):
    """The own histogram of the first point: what PCFH adds to its neighbors' sum of 100."""
    bins = options.get("bins", 11)
    rows = oracles.hhd(values, near, bins)
    return rows[0], tr.pcfh(cloud, near, values=values, **options).values[0]


@pytest.mark.parametrize("bins", [1, 2, 5, 11, 16, 64])
@pytest.mark.parametrize("weighted", [False, True])
def test_values_are_those_of_the_equations(bins, weighted):
    cloud = sphere_cloud(120)
    near = tr.neighbors(cloud, 0.5, 120)
    assert (near.counts() <= 3).any()
    values = color_values(cloud)
    found = tr.pcfh(cloud, near, bins=bins, saturation_weighting=weighted)
    expected = oracles.pcfh(values, near, bins, weighted=weighted)
    assert found.blocks == (("pcfh", bins),)
    # with weights a vote is a whole number of 1/1024
    assert (found.values - expected).abs().max() < (5e-1 if weighted else 1e-4)


@pytest.mark.parametrize("channels", [("hue",), ("saturation",), ("value", "hue"), CHANNELS])
def test_channels_stand_one_after_another(channels):
    cloud = sphere_cloud(100, seed=1)
    near = tr.neighbors(cloud, 0.6, 60)
    found = tr.pcfh(cloud, near, bins=7, channels=channels, equalization="none")
    expected = oracles.pcfh(color_values(cloud, "none"), near, 7, channels)
    assert found.blocks == (("pcfh", 7 * len(channels)),)
    assert (found.values - expected).abs().max() < 1e-4
    single = torch.cat(
        [tr.pcfh(cloud, near, bins=7, channels=(one,), equalization="none").values for one in channels], dim=1
    )
    assert close(found.values, single, atol=1e-12)


def test_float32_is_within_rounding_of_the_equations():
    scan = room_pair(500).source
    near = tr.neighbors(scan, 1.0, 60)
    values = color_values(scan)
    found = tr.pcfh(scan, near).values
    assert found.dtype == torch.float32
    assert (found - oracles.pcfh(values, near, 11)).abs().max() < 1e-3


def test_a_valid_row_sums_to_200():
    scan = room_pair(500).source
    features = tr.pcfh(scan, tr.neighbors(scan, 1.0, 60))
    assert torch.allclose(features.values.sum(dim=1)[features.valid], torch.tensor(200.0), rtol=1e-5)
    assert not features.values[~features.valid].any()


@pytest.mark.parametrize(
    ("one", "other", "difference"),
    [(0.99, 0.01, 0.04), (0.01, 0.99, 0.04), (0.0, 0.5, 1.0), (0.25, 0.75, 1.0), (0.0, 1.0, 0.0), (0.2, 0.45, 0.5)],
)
def test_hue_is_a_circle(one, other, difference):
    pair = (torch.tensor([one], dtype=torch.float64), torch.tensor([other], dtype=torch.float64))
    for bins in (11, 1000):
        found = int(difference_bins(*pair, bins, circular=True))
        assert found in {min(bins - 1, int((difference + shift) * bins)) for shift in (-1e-12, 1e-12)}


@given(st.floats(0, 1), st.floats(0, 1), st.integers(1, 40), st.booleans())
def test_difference_bins_are_symmetric_and_in_range(one, other, bins, circular):
    a, b = torch.tensor([one]), torch.tensor([other])
    forth = difference_bins(a, b, bins, circular=circular)
    assert torch.equal(forth, difference_bins(b, a, bins, circular=circular))
    assert 0 <= int(forth) < bins
    assert int(difference_bins(a, a, bins, circular=circular)) == 0


def test_inputs_are_not_written_to():
    values = torch.rand(50, generator=torch.Generator().manual_seed(0))
    before = values.clone()
    difference_bins(values[:1], values, 11, circular=True)
    assert torch.equal(values, before)


def test_a_hand_made_histogram():
    # 0.04 and 0.04 fall into bin 0, 0.5 into bin 5, 1.0 into the last
    own, row = hhd_of_center(*star(0.01, 0.97, 0.24, 0.49, own=0.99))
    assert own.tolist() == [50, 0, 0, 0, 0, 25, 0, 0, 0, 0, 25]
    assert float(row.sum()) == pytest.approx(200)


def test_turning_all_hues_changes_nothing():
    cloud = sphere_cloud(150)
    near = tr.neighbors(cloud, 0.6, 60)
    values = color_values(cloud, "none")
    turned = values.clone()
    turned[:, 0] = (turned[:, 0] + 0.37) % 1
    assert close(tr.pcfh(cloud, near, values=values).values, tr.pcfh(cloud, near, values=turned).values, atol=1e-9)


@pytest.mark.parametrize("neighbors", range(5))
def test_fewer_than_three_neighbors_make_a_zero_row(neighbors):
    cloud, near, values = star(*[0.1] * neighbors)
    features = tr.pcfh(cloud, near, values=values)
    assert bool(features.valid[0]) == (neighbors >= 3)
    assert bool((features.values[0] != 0).any()) == (neighbors >= 3)


def test_neighbors_with_few_neighbors_of_their_own_give_nothing():
    # the center has three neighbors, the others see the center alone
    cloud = tr.Clouds(points=torch.tensor([[0.0, 0, 0], [1, 0, 0], [-0.5, 0.87, 0], [-0.5, -0.87, 0]]))
    near = tr.neighbors(cloud, 1.2, 4)
    features = tr.pcfh(cloud, near, values=torch.zeros(4, 3))
    assert features.valid.tolist() == [True, False, False, False]
    assert features.values[0].tolist() == pytest.approx([100.0] + [0.0] * 10)


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_a_gray_cloud_has_all_differences_zero_by_the_plain_rule(level):
    cloud = sphere_cloud(100)
    gray = tr.Clouds(points=cloud.points, colors=torch.full_like(cloud.points, level))
    features = tr.pcfh(gray, tr.neighbors(gray, 0.8, 40))
    assert torch.allclose(features.values[features.valid, 0], torch.tensor(200.0, dtype=torch.float64))
    assert not features.values[:, 1:].any()


def test_a_gray_cloud_has_no_say_when_votes_count_by_saturation():
    cloud = sphere_cloud(100)
    gray = tr.Clouds(points=cloud.points, colors=torch.full_like(cloud.points, 0.5))
    features = tr.pcfh(gray, tr.neighbors(gray, 0.8, 40), saturation_weighting=True)
    assert not features.values.any()
    assert not features.valid.any()


def test_gray_neighbors_do_not_vote_when_votes_count_by_saturation():
    cloud, near, values = star(0.5, 0.5, 0.5, 0.0)
    values[1:4, 1] = 0  # the three opposite hues are gray
    weighted = tr.pcfh(cloud, near, values=values, saturation_weighting=True).values[0]
    plain = tr.pcfh(cloud, near, values=values).values[0]
    assert weighted[0] == 200
    assert plain[10] >= 75


def test_saturation_weights_the_vote_on_hue_alone():
    cloud = sphere_cloud(100)
    near = tr.neighbors(cloud, 0.8, 40)
    others = ("saturation", "value")
    assert same_bits(
        tr.pcfh(cloud, near, channels=others, saturation_weighting=True), tr.pcfh(cloud, near, channels=others)
    )


def test_duplicates_of_a_point_vote_but_weigh_nothing():
    cloud = sphere_cloud(40)
    twice = tr.Clouds(points=cloud.points.repeat(2, 1), colors=cloud.colors.repeat(2, 1))
    near = tr.neighbors(twice, 0.8, 30)
    found = tr.pcfh(twice, near).values
    assert torch.isfinite(found).all()
    assert (found - oracles.pcfh(color_values(twice), near, 11)).abs().max() < 1e-4


@settings(max_examples=15)
@given(st.integers(0, 2**31))
def test_a_rigid_motion_changes_nothing(seed):
    cloud = sphere_cloud(150, seed=seed)
    near = tr.neighbors(cloud, 0.6, 60)
    moved = tr.transform(cloud, random_transform(torch.Generator().manual_seed(seed)))
    moved = tr.Clouds(points=moved.points + moved.origin, colors=moved.colors)
    found = tr.pcfh(moved, tr.neighbors(moved, 0.6, 60))
    assert close(found.values, tr.pcfh(cloud, near).values, atol=1e-9)


def test_jointly_equalized_values_are_taken_as_they_are():
    pair = room_pair(300)
    values, _ = joint_color_values(pair.source, pair.target)
    near = tr.neighbors(pair.source, 0.9, 40)
    found = tr.pcfh(pair.source, near, values=values, equalization="none")
    assert same_bits(found, tr.pcfh(pair.source, near, values=values))
    assert (found.values - oracles.pcfh(values, near, 11)).abs().max() < 1e-3


def test_the_cloud_is_equalized_by_default():
    scan = room_pair(300).source
    near = tr.neighbors(scan, 0.9, 40)
    equalized, plain = color_values(scan, "cloud"), color_values(scan, "none")
    assert same_bits(tr.pcfh(scan, near), tr.pcfh(scan, near, values=equalized))
    assert same_bits(tr.pcfh(scan, near, equalization="none"), tr.pcfh(scan, near, values=plain))


def test_what_does_not_fit_is_refused():
    cloud, near, values = star(0.1, 0.2, 0.3)
    with refuses("cloud", "colors", "none"):
        tr.pcfh(cloud, near)
    with refuses("bins", "at least 1", "0"):
        tr.pcfh(cloud, near, values=values, bins=0)
    with refuses("channels", "'hue'", "'red'"):
        tr.pcfh(cloud, near, values=values, channels=("red",))
    with refuses("channels", "at least one", "()"):
        tr.pcfh(cloud, near, values=values, channels=())
    with refuses("values", "(4, 3)", "(3, 3)"):
        tr.pcfh(cloud, near, values=values[:3])
    with refuses("near", "4 points", "3"):
        short = tr.Neighborhoods(near.index[:3], near.valid[:3], near.sq_distance[:3])
        tr.pcfh(cloud, short, values=values)
    colored = tr.Clouds(points=cloud.points, colors=cloud.points.abs().clamp(max=1))
    with refuses("equalization", "'none', 'cloud'", "'joint'"):
        tr.pcfh(colored, near, equalization="joint")
