"""Hue, saturation and value as Python's colorsys has them, and equalization of hue."""

import colorsys

import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from hypothesis import given
from hypothesis import strategies as st
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.color import HUE_LEVELS, color_values, equalize, hsv, joint_color_values
from torchreg.types.packing import offsets_of


def painted(colors, lengths=None):
    colors = torch.as_tensor(colors, dtype=torch.float64)
    offsets = None if lengths is None else offsets_of(lengths)
    return tr.Clouds(points=torch.zeros_like(colors), colors=colors, offsets=offsets)


def random_hues(count, seed=0):
    """Hues that crowd at one side of the circle."""
    return torch.rand(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).pow(3)


unit = st.floats(0, 1)


@given(st.lists(st.tuples(unit, unit, unit), min_size=1, max_size=20))
def test_values_are_those_of_colorsys(colors):
    found = hsv(torch.tensor(colors, dtype=torch.float64))
    for color, (hue, saturation, value) in zip(colors, found.tolist(), strict=True):
        expected = colorsys.rgb_to_hsv(*color)
        if max(color) > 1e-3 and expected[1] > 1e-3:  # the hue of gray is open
            apart = abs(hue - expected[0])
            assert min(apart, 1 - apart) < 1e-5
        assert abs(saturation - expected[1]) < 1e-4 or max(color) < 1e-3
        assert abs(value - expected[2]) < 1e-12


@pytest.mark.parametrize(
    ("color", "hue"),
    [
        ((1, 0, 0), 0),
        ((1, 1, 0), 1 / 6),
        ((0, 1, 0), 2 / 6),
        ((0, 1, 1), 3 / 6),
        ((0, 0, 1), 4 / 6),
        ((1, 0, 1), 5 / 6),
    ],
)
def test_pure_colors_lie_around_the_circle(color, hue):
    found = hsv(torch.tensor([color], dtype=torch.float64))[0]
    assert close(found, torch.tensor([hue, 1.0, 1.0], dtype=torch.float64), atol=1e-7)


@pytest.mark.parametrize("level", [0.0, 0.3, 1.0])
def test_gray_has_hue_and_saturation_zero(level):
    assert hsv(torch.tensor([[level] * 3], dtype=torch.float64))[0].tolist() == [0, 0, level]


@given(st.lists(st.tuples(unit, unit, unit), min_size=1, max_size=20))
def test_values_lie_between_0_and_1(colors):
    found = hsv(torch.tensor(colors))
    assert (found >= 0).all()
    assert (found <= 1).all()


def test_a_color_has_its_bits_whatever_stands_beside_it():
    colors = room_pair(2000).source.colors
    together = hsv(colors)
    for cut in (slice(0, 1), slice(3, 20), slice(500, 1501)):
        assert same_bits(hsv(colors[cut]), together[cut])
    for number in THREADS:
        with threads(number):
            assert same_bits(hsv(colors.repeat(30, 1))[: len(colors)], together)


@given(st.integers(0, 2**31), st.integers(2, 300))
def test_equalization_keeps_the_order_of_hues(seed, count):
    hue = random_hues(count, seed)
    order = hue.argsort()
    equalized = equalize(hue, offsets_of([count]))[order]
    assert (equalized.diff() >= 0).all()
    assert equalized[0] == 0
    assert equalized[-1] == 1 or equalized[-1] == equalized[0]
    level = (hue * HUE_LEVELS).long()[order]
    assert torch.equal(level.diff() == 0, equalized.diff() == 0)


def test_equalized_hues_are_spread_evenly():
    hue = random_hues(100_000)
    equalized = equalize(hue, offsets_of([len(hue)])).sort().values
    even = torch.linspace(0, 1, len(hue), dtype=torch.float64)
    # one level of 256 may hold a good part of a crowd: where hues are not crowded the map is exact
    assert (equalized - even).abs().max() < float(torch.bincount((hue * HUE_LEVELS).long()).max()) / len(hue) * 1.3
    flat = torch.rand(100_000, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    assert (equalize(flat, offsets_of([len(flat)])) - flat).abs().max() < 0.02


def test_equalization_undoes_a_monotone_change_of_hues():
    level = torch.randint(HUE_LEVELS // 2, (500,), generator=torch.Generator().manual_seed(2))
    hue = (level + 0.5) / HUE_LEVELS
    offsets = offsets_of([500])
    assert same_bits(equalize(hue, offsets), equalize(2 * hue, offsets))
    assert same_bits(equalize(hue, offsets), equalize(hue + 0.25, offsets))


def test_equalization_does_not_depend_on_how_often_all_points_stand_there():
    hue = random_hues(300)
    twice = equalize(hue.repeat(2), offsets_of([600]))
    assert close(twice[:300], equalize(hue, offsets_of([300])), atol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_one_hue_alone_maps_to_zero(count):
    assert equalize(torch.full((count,), 0.7), offsets_of([count])).tolist() == [0] * count


def test_hues_at_the_ends_are_counted():
    assert equalize(torch.tensor([0.0, 1.0]), offsets_of([2])).tolist() == [0, 1]


def test_every_cloud_is_equalized_by_itself():
    hue = [random_hues(count, count) for count in (50, 0, 1, 200)]
    together = equalize(torch.cat(hue), offsets_of(map(len, hue)))
    assert same_bits(together, torch.cat([equalize(one, offsets_of([len(one)])) for one in hue]))


def test_color_values_equalize_hue_alone():
    scan = room_pair(500).source
    plain, equalized = color_values(scan, "none"), color_values(scan, "cloud")
    assert same_bits(plain, hsv(scan.colors))
    assert torch.equal(plain[:, 1:], equalized[:, 1:])
    assert torch.equal(equalized[:, 0], equalize(plain[:, 0], scan.offsets))
    assert not torch.equal(equalized[:, 0], plain[:, 0])


def test_joint_equalization_has_one_map_for_both_clouds():
    red, yellow, green = (1.0, 0, 0), (1.0, 1, 0), (0.0, 1, 0)
    source, target = painted([red, yellow, yellow]), painted([yellow, green])
    of_source, of_target = joint_color_values(source, target)
    # of five points one is red and three are yellow: red 0, yellow (4 - 1) / 4, green 1
    assert of_source[:, 0].tolist() == [0, 0.75, 0.75]
    assert of_target[:, 0].tolist() == [0.75, 1]
    assert color_values(source)[:, 0].tolist() == [0, 1, 1]
    assert color_values(target)[:, 0].tolist() == [0, 1]
    assert torch.equal(of_source[:, 1:], hsv(source.colors)[:, 1:])


def test_joint_equalization_is_one_map_on_random_clouds():
    source, target = room_pair(400)[:2]
    of_source, of_target = joint_color_values(source, target)
    hue = torch.cat([hsv(source.colors)[:, 0], hsv(target.colors)[:, 0]])
    both = equalize(hue, offsets_of([len(hue)]))
    assert same_bits(torch.cat([of_source[:, 0], of_target[:, 0]]), both)


def test_joint_equalization_of_a_batch_equals_the_loop_over_its_pairs():
    pairs = [room_pair(count, seed=count)[:2] for count in (300, 100, 500)]
    source, target = (tr.Clouds.pack(side) for side in zip(*pairs, strict=True))
    together = joint_color_values(source, target)
    alone = [joint_color_values(*pair) for pair in pairs]
    assert same_bits(together, tuple(map(torch.cat, zip(*alone, strict=True))))


def test_gradients_of_conversion_are_right():
    colors = torch.tensor([[0.9, 0.2, 0.4], [0.1, 0.8, 0.3], [0.2, 0.3, 0.7]], dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(hsv, colors)


def test_gradients_of_gray_are_finite():
    colors = torch.tensor([[0.5, 0.5, 0.5], [0.0, 0, 0], [1, 1, 1]], dtype=torch.float64).requires_grad_()
    hsv(colors).sum().backward()
    assert torch.isfinite(colors.grad).all()


def test_what_does_not_fit_is_refused():
    bare = tr.Clouds(points=torch.zeros(2, 3))
    with refuses("cloud", "colors", "none"):
        color_values(bare)
    with refuses("cloud", "colors", "none"):
        joint_color_values(painted([(1, 0, 0)]), bare)
    with refuses("equalization", "'cloud'", "'joint'"):
        color_values(painted([(1, 0, 0)]), "joint")
    with refuses("colors", "(P, 3)", "(3,)"):
        hsv(torch.zeros(3))
    with refuses("target", "1 clouds", "2"):
        joint_color_values(painted([(1, 0, 0)]), painted([(1, 0, 0)] * 2, [1, 1]))
